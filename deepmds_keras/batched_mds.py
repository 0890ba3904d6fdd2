"""Non-metric MDS of many dissimilarity matrices: the iterates of scikit-learn, without its cost."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
from scipy.optimize import isotonic_regression
from scipy.spatial.distance import pdist, squareform

# Constants of scikit-learn: dissimilarities that exceed the smallest of their group by less are
# ties, and points that coincide count as this far apart.
_TIE = 1e-15
_COINCIDENT = 1e-5
_PAIRS_AT_ONCE = 2**18  # 2 MB an array


def batched_mds(
    dissimilarities: np.ndarray, start: np.ndarray, max_iter: int = 300, eps: float = 1e-6
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """SMACOF with isotonic regression (Kruskal's non-metric MDS, stress-1) of each matrix.

    Makes the same steps from `start` as scikit-learn's `MDS` (1.9, not metric, one initialisation)
    and stops at the same one, so it agrees to rounding. It is faster because the order of the
    dissimilarities, which never changes, is found once; because the blocks of one iteration's
    regression start that of the next; and because it is compiled where numba is installed.
    Without numba the same steps are made by SciPy's regression, several times more slowly.

    Each face is solved by itself: its result does not depend, to the last bit, on the others.

    Args:
        dissimilarities: `(n, L, L)`, symmetric with zero diagonal and no negative entries, as
            `check_dissimilarities` returns them. Zeros off the diagonal are missing values.
        start: `(n, L, k)` points to start from.
        max_iter: Most iterations for a face.
        eps: Decrease of stress, relative to the sum of squared distances, at which to stop.

    Returns:
        `(n, L, k)` points whose scale has no meaning, `(n,)` stress-1 and `(n,)` iterations.
    """
    solve = smacof_solver()
    start = np.array(start, float, order="C")
    n, n_landmarks, _ = start.shape
    matrices = np.asarray(dissimilarities, float).reshape(n, -1)
    upper = np.flatnonzero(np.triu(np.ones((n_landmarks, n_landmarks)), 1))
    points, stress, n_iter = np.empty(start.shape), np.empty(n), np.empty(n, int)
    step = max(1, _PAIRS_AT_ONCE // len(upper))
    for faces in (slice(i, i + step) for i in range(0, n, step)):
        pairs = matrices[faces].take(upper, axis=1)
        solved = solve(pairs, pairs.argsort(1), start[faces], int(max_iter), float(eps))
        points[faces], stress[faces], n_iter[faces] = solved
    return points, stress, n_iter


@functools.cache
def smacof_solver() -> Callable:
    """The compiled solver where numba can be imported, else `smacof`."""
    try:
        from deepmds_keras import compiled_smacof
    except ImportError:
        return smacof
    return compiled_smacof.smacof


def is_compiled() -> bool:
    """Whether the solver is the compiled one."""
    return smacof_solver() is not smacof


def smacof(
    pairs: np.ndarray, order: np.ndarray, start: np.ndarray, max_iter: int, eps: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`batched_mds` without numba, on pairs.

    Args:
        pairs: `(n, P)` dissimilarities of the pairs of landmarks, row by row of the upper triangle.
        order: `(n, P)` positions that sort each face's pairs in ascending order.
        start: `(n, L, k)` points.
        max_iter: Most iterations for a face.
        eps: Decrease at which to stop.

    Returns:
        As `batched_mds`.
    """
    points, stress, n_iter = np.empty(start.shape), np.empty(len(start)), np.empty(len(start), int)
    for face in range(len(start)):
        solved = _smacof_of_face(pairs[face], order[face], start[face], max_iter, eps)
        points[face], stress[face], n_iter[face] = solved
    return points, stress, n_iter


def _smacof_of_face(pairs, order, points, max_iter, eps):
    order = order[np.count_nonzero(pairs == 0) :]
    starts = _group_starts(pairs[order])
    sizes = np.diff(starts, append=len(order))
    disparities = pairs.copy()  # of the first iteration
    distances = pdist(points)
    previous = np.inf
    for iteration in range(1, max_iter + 1):
        if iteration > 1:
            means = np.add.reduceat(distances[order], starts) / sizes
            disparities[order] = np.repeat(isotonic_regression(means, weights=sizes).x, sizes)
        disparities *= np.sqrt(len(pairs) / np.square(disparities).sum())
        distances[distances == 0] = _COINCIDENT
        ratios = squareform(disparities / distances, checks=False)
        points = (ratios.sum(1)[:, None] * points - ratios @ points) / len(points)
        distances = pdist(points)
        raw, size = np.square(distances - disparities).sum(), np.square(distances).sum()
        if (previous - raw) / size < eps:
            break
        previous = raw
    return points, np.sqrt(raw / size), iteration


def _group_starts(values: np.ndarray) -> np.ndarray:
    """Where groups of ties begin in ascending values."""
    positions = np.arange(len(values))
    starts = np.diff(values, prepend=-np.inf) >= _TIE
    while True:  # again only where ties a rounding error apart add up to more than a tie
        smallest = values[np.maximum.accumulate(np.where(starts, positions, 0))]
        beyond = values - smallest >= _TIE
        if not beyond.any():
            return np.flatnonzero(starts)
        starts |= beyond & ~np.append(False, beyond[:-1])
