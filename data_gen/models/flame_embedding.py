"""Landmarks on FLAME: points within triangles of its mesh."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_gen.formats.plain_pickle import load_plain_pickle
from data_gen.landmarks import load_vertices
from deepmds_keras.errors import InputError

SOURCE = "the public repository github.com/TimoBolkart/TF_FLAME"
# The last landmarks of ibug68 are those of ibug51.
FILENAMES = ("flame_static_embedding.pkl", "flame_static_embedding_68.pkl")
_FOLDERS = ("", "data/", "models/", "FLAME/", "flame/", "FLAME2020/", "FLAME2023/", "tf_flame/")
_SIZES = tuple(len(load_vertices(scheme).numbers) for scheme in ("ibug51", "ibug68"))
_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class LandmarkEmbedding:
    """The 51 landmarks iBUG 18 to 68 as points within triangles of a mesh.

    Attributes:
        triangles: `(51,)` int, 0-based triangle numbers.
        weights: `(51, 3)`, barycentric, of the triangles' corners in the order of the mesh's file;
            rows sum to 1.
    """

    triangles: np.ndarray
    weights: np.ndarray

    def points(self, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
        """The landmarks of meshes.

        Args:
            vertices: `(..., V, 3)`, or offsets of a linear model: the map is linear.
            triangles: `(T, 3)` int, 0-based, in the order of the mesh's file.

        Returns:
            `(..., 51, 3)` in the unit of the vertices.

        Raises:
            InputError: The mesh has fewer triangles than the landmarks lie on.
        """
        if self.triangles.max() >= len(triangles):
            raise InputError(
                f"triangles must be those of FLAME, at least {self.triangles.max() + 1}. "
                f"Received {len(triangles)}."
            )
        corners = vertices[..., triangles[self.triangles], :]
        return np.einsum("lc,...lcd->...ld", self.weights, corners)


def find_embedding(*folders: str | Path) -> Path:
    """The embedding's file, in the first of the folders that holds it, or its usual folder.

    Raises:
        InputError: It is in none; the message says where to get it.
    """
    for folder in folders:
        for filename in FILENAMES:
            for inner in _FOLDERS:
                if (Path(folder) / inner / filename).is_file():
                    return Path(folder) / inner / filename
    raise InputError(
        f"{folders[0]}: must hold {FILENAMES[0]}, FLAME's landmarks, from {SOURCE}. Received none."
    )


def embedding_near(path: str | Path) -> LandmarkEmbedding:
    """The embedding beside or within a file or folder, or up to two folders above it.

    Raises:
        InputError: As `find_embedding` and `load_embedding`.
    """
    path = Path(path).absolute()
    return load_embedding(find_embedding(path, *path.parents[:2]))


def load_embedding(path: str | Path) -> LandmarkEmbedding:
    """Reads `flame_static_embedding.pkl`, or the last 51 landmarks of that of all 68.

    Args:
        path: The file, or a folder that holds it.

    Raises:
        InputError: The file is missing, damaged or of another content.
    """
    file = Path(path) if Path(path).is_file() else find_embedding(path)
    arrays = load_plain_pickle(file)
    arrays = arrays if isinstance(arrays, dict) else {}
    triangles, weights = (arrays.get(key) for key in ("lmk_face_idx", "lmk_b_coords"))
    is_known = isinstance(triangles, np.ndarray) and triangles.ndim == 1
    is_known = is_known and len(triangles) in _SIZES and triangles.dtype.kind in "iu"
    if not is_known or triangles.min() < 0:
        raise InputError(
            f"{file}: lmk_face_idx must be {_SIZES[0]} or {_SIZES[1]} triangle numbers. Received "
            f"{_description(triangles)}."
        )
    if not isinstance(weights, np.ndarray) or weights.shape != (len(triangles), 3):
        raise InputError(
            f"{file}: lmk_b_coords must be of shape ({len(triangles)}, 3). Received "
            f"{_description(weights)}."
        )
    sums_to_one = weights.dtype.kind == "f" and np.abs(weights.sum(axis=1) - 1) <= _TOLERANCE
    # The official file has weights of -1e-13.
    if not np.all(sums_to_one) or weights.min() < -_TOLERANCE:
        raise InputError(
            f"{file}: lmk_b_coords must not be negative, and sum to 1 for each landmark. Received "
            f"{_description(weights)}."
        )
    return LandmarkEmbedding(
        triangles[-_SIZES[0] :].astype(int), weights[-_SIZES[0] :].astype(float)
    )


def _description(array) -> str:
    if not isinstance(array, np.ndarray):
        return "nothing" if array is None else type(array).__name__
    return f"{array.dtype} {array.shape}, from {array.min()} to {array.max()}"
