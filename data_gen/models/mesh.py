"""Facts about triangle meshes: which way they face, and which vertices are connected."""

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components

from deepmds_keras.errors import InputError


def check_triangles(triangles: np.ndarray, n_vertices: int) -> None:
    """Refuse what are not triangles of a mesh.

    Raises:
        InputError: The array is not `(T, 3)` of integers, or one is not a number of a vertex.
    """
    if triangles.ndim != 2 or triangles.shape[1] != 3 or triangles.dtype.kind not in "iu":
        raise InputError(
            f"triangles must be (T, 3) integers. Received {triangles.dtype} {triangles.shape}."
        )
    if triangles.size and not 0 <= triangles.min() <= triangles.max() < n_vertices:
        raise InputError(
            f"triangles must number {n_vertices} vertices from 0. "
            f"Received {triangles.min()} to {triangles.max()}."
        )


def vertex_normals(
    vertices: np.ndarray, triangles: np.ndarray, corners: csr_matrix | None = None
) -> np.ndarray:
    """Unit normals `(V, 3)`, area-weighted over the triangles that meet at a vertex, or zero.

    Args:
        vertices: `(V, 3)`.
        triangles: `(T, 3)` int, 0-based.
        corners: As from `triangle_corners`, to compute normals of the same mesh many times.
    """
    if corners is None:
        corners = triangle_corners(len(vertices), triangles)
    normals = corners @ _area_vectors(vertices, triangles)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, length, out=normals, where=length > 0)


def triangle_corners(n_vertices: int, triangles: np.ndarray) -> csr_matrix:
    """`(V, T)` sparse, 1 where a triangle meets a vertex: sums over triangles are one product."""
    corners = triangles.T.ravel()
    numbers = np.tile(np.arange(len(triangles)), 3)
    ones = np.ones(len(corners))
    return csr_matrix((ones, (corners, numbers)), shape=(n_vertices, len(triangles)))


def orient_outwards(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The same triangles `(T, 3)`, counter-clockwise seen from outside.

    All triangles are assumed to be wound alike. The sign of the volume that they span with the
    mean vertex decides; a face that is open behind still has most of its area in front of it.
    """
    offsets = vertices[triangles].mean(axis=1) - vertices.mean(axis=0)
    volume = np.einsum("td,td->", offsets, _area_vectors(vertices, triangles))
    return triangles if volume >= 0 else np.ascontiguousarray(triangles[:, ::-1])


def components(n_vertices: int, triangles: np.ndarray) -> np.ndarray:
    """Number of the connected part that each vertex belongs to, `(V,)`; the largest part is 0."""
    rows, columns = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]]]).T
    edges = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(n_vertices, n_vertices))
    label = connected_components(edges, directed=False)[1]
    by_size = np.argsort(-np.bincount(label), kind="stable")
    return np.argsort(by_size)[label]


def largest_component(n_vertices: int, triangles: np.ndarray) -> np.ndarray:
    """Sorted vertex numbers of the largest connected part: the skin without eyes and teeth."""
    return np.flatnonzero(components(n_vertices, triangles) == 0)


def _area_vectors(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = vertices[triangles.T]
    return np.cross(b - a, c - a)
