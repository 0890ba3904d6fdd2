"""Classical scaling: points from Euclidean distances by an eigenvalue problem (Torgerson 1952)."""

import numpy as np


def classical_scaling(dissimilarities: np.ndarray, n_components: int = 3) -> np.ndarray:
    """Classical (Torgerson) scaling of each matrix: `(n, L, L)` → `(n, L, n_components)`.

    Components of negative eigenvalues, which Euclidean distances do not have, are zero. Distances
    leave the sign of a component open; the first landmark far out on it gets a positive coordinate.
    """
    values, vectors = np.linalg.eigh(doubly_centred(dissimilarities))
    largest = slice(None, -n_components - 1, -1)
    values, vectors = values[:, largest], vectors[..., largest]
    return with_signs(vectors * np.sqrt(np.maximum(values, 0))[:, None])


def doubly_centred(dissimilarities: np.ndarray) -> np.ndarray:
    """Minus half the squares, with rows and columns that sum to 0 (Torgerson 1952).

    Of distances these are the Gram matrices of the points about their mean: `(…, L, L)` → the same.
    """
    squared = np.square(np.asarray(dissimilarities, float))
    rows = squared.mean(-1, keepdims=True)
    return -0.5 * (squared - rows - np.swapaxes(rows, -1, -2) + rows.mean(-2, keepdims=True))


def pairwise_distances(points: np.ndarray) -> np.ndarray:
    """Euclidean distances between all pairs of points: `(…, L, d)` → `(…, L, L)` float64."""
    points = np.asarray(points, float)
    return np.linalg.norm(points[..., :, None, :] - points[..., None, :, :], axis=-1)


def with_signs(points: np.ndarray) -> np.ndarray:
    """Points `(..., L, k)`, each axis signed so that the first landmark far out is positive.

    The sign of an eigenvector depends on rounding, hence on the processor, and in a symmetric face
    so does which of two landmarks is farthest out. The first of those at least 0.6 times as far
    out does not.
    """
    sizes = np.abs(points)
    first = (sizes >= 0.6 * sizes.max(-2, keepdims=True)).argmax(-2)
    return points * np.sign(np.take_along_axis(points, first[..., None, :], -2))
