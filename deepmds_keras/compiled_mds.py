"""Non-metric MDS of one dissimilarity matrix, compiled: the steps of scikit-learn, not its cost."""

import numba
import numpy as np
from scipy.spatial.distance import squareform

# Constants of scikit-learn: dissimilarities that exceed the smallest of their group by less are
# ties, and points that coincide count as this far apart.
_TIE = 1e-15
_COINCIDENT = 1e-5
# Sums may be taken in another order, which vector instructions need; NaN and infinity stay.
_REORDERED = {"reassoc", "contract", "nsz"}


def compiled_mds(
    dissimilarities: np.ndarray, start: np.ndarray, max_iter: int = 300, eps: float = 1e-6
) -> tuple[np.ndarray, float, int]:
    """SMACOF with isotonic regression (Kruskal's non-metric MDS, stress-1) of one face.

    Takes the same steps from `start` as scikit-learn's `MDS` (1.9, not metric, one initialisation),
    so the two agree to rounding. It is faster because it is compiled, sorts the dissimilarities
    only once, and starts each regression from the blocks of the previous one.

    Args:
        dissimilarities: `(L, L)`, symmetric with zero diagonal and no negative entries. Zeros off
            the diagonal are missing values.
        start: `(L, k)` points to start from.
        eps: Decrease of stress, relative to the sum of squared distances, at which to stop.

    Returns:
        `(L, k)` points whose scale has no meaning, stress-1 and the number of iterations.
    """
    pairs = squareform(np.asarray(dissimilarities, float), checks=False)
    start = np.array(start, float, order="C")
    return _smacof(pairs, pairs.argsort(), start, int(max_iter), float(eps))


def _compiled(function):
    """Compile; the machine code is cached on disk if a folder for it can be written."""
    options = {"error_model": "numpy", "nogil": True, "fastmath": _REORDERED}
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:
        return numba.njit(**options)(function)


@_compiled
def _smacof(pairs, order, start, max_iter, eps):
    """`compiled_mds` of `(P,)` pairs, row by row of the upper triangle, that `order` sorts."""
    n_landmarks, n_components = start.shape
    n_pairs = len(pairs)
    points, moved = start.T.copy(), np.empty((n_components, n_landmarks))
    distances, disparities, ratios = np.empty(n_pairs), pairs.copy(), np.empty(n_pairs)
    values, sums, weights = np.empty(n_pairs), np.empty(n_pairs), np.empty(n_pairs)
    blocks, new_blocks = np.empty(n_pairs + 1, np.uint32), np.empty(n_pairs + 1, np.uint32)
    all_positions, all_tied = np.empty(n_pairs, np.uint32), np.empty(n_pairs, np.bool_)
    n_known = _read_order(pairs, order, all_positions, all_tied)
    positions, tied = all_positions[:n_known], all_tied[:n_known]
    blocks[0], blocks[1], n_blocks = 0, n_known, 1
    _pair_distances(points, distances)
    previous = np.inf
    for iteration in range(1, max_iter + 1):
        if iteration > 1:  # the first takes the dissimilarities as they are
            for rank in range(n_known):
                values[rank] = distances[positions[rank]]
            n_blocks = _pool(values, tied, blocks, n_blocks, new_blocks, sums, weights)
            blocks[: n_blocks + 1] = new_blocks[: n_blocks + 1]
            for block in range(n_blocks):
                mean = sums[block] / weights[block]
                for rank in range(blocks[block], blocks[block + 1]):
                    disparities[positions[rank]] = mean
        _rescale(disparities)
        _move(points, distances, disparities, ratios, moved)
        _pair_distances(points, distances)
        raw, size = _raw_stress(distances, disparities)
        if (previous - raw) / size < eps:
            break
        previous = raw
    return points.T.copy(), np.sqrt(raw / size), iteration


@_compiled
def _read_order(pairs, order, positions, tied):
    """Fill the positions of the known pairs and whether each ties with the one before it."""
    n_known, smallest = 0, -np.inf
    for position in order:
        if pairs[position] != 0:
            positions[n_known] = position
            tied[n_known] = pairs[position] - smallest < _TIE
            if not tied[n_known]:
                smallest = pairs[position]
            n_known += 1
    return n_known


@_compiled
def _pair_distances(points, distances):
    """Fill the distances of the pairs of `(k, L)` points."""
    n_landmarks, first = points.shape[1], 0
    distances[:] = 0
    for landmark in range(n_landmarks - 1):
        row = distances[first : first + n_landmarks - 1 - landmark]
        for axis in range(len(points)):
            here, others = points[axis, landmark], points[axis, landmark + 1 :]
            for i in range(len(row)):
                row[i] += (here - others[i]) ** 2
        first += len(row)
    for pair in range(len(distances)):
        distances[pair] = np.sqrt(distances[pair])


@_compiled
def _rescale(disparities):
    squares = 0.0
    for pair in range(len(disparities)):
        squares += disparities[pair] ** 2
    scale = np.sqrt(len(disparities) / squares)
    for pair in range(len(disparities)):
        disparities[pair] *= scale


@_compiled
def _move(points, distances, disparities, ratios, moved):
    """Guttman transform of the points, in place."""
    n_landmarks, first = points.shape[1], 0
    for pair in range(len(ratios)):
        distance = distances[pair]
        ratios[pair] = disparities[pair] / (_COINCIDENT if distance == 0 else distance)
    moved[:] = 0
    for landmark in range(n_landmarks - 1):
        row = ratios[first : first + n_landmarks - 1 - landmark]
        for axis in range(len(points)):
            here, others = points[axis, landmark], points[axis, landmark + 1 :]
            pulled, total = moved[axis, landmark + 1 :], 0.0
            for i in range(len(row)):
                pull = row[i] * (here - others[i])
                pulled[i] -= pull
                total += pull
            moved[axis, landmark] += total
        first += len(row)
    points[:] = moved / n_landmarks


@_compiled
def _raw_stress(distances, disparities):
    raw, size = 0.0, 0.0
    for pair in range(len(distances)):
        raw += (distances[pair] - disparities[pair]) ** 2
        size += distances[pair] ** 2
    return raw, size


@_compiled
def _pool(values, tied, blocks, n_blocks, new_blocks, sums, weights):
    """Isotonic regression of `(P,)` values by pooling adjacent violators; the number of blocks.

    Violators may be pooled in any order. `blocks` has the bounds of the blocks of the previous
    regression. A block whose leading values never average below its mean would stay in one piece,
    so it enters whole, as over nine in ten do; any other enters value by value, ties together. The
    solution is written into the last three arrays.
    """
    n_new = 0
    for block in range(n_blocks):
        rank, end = blocks[block], blocks[block + 1]
        total = 0.0
        for i in range(rank, end):
            total += values[i]
        mean, excess, whole = total / (end - rank), 0.0, True
        for i in range(rank, end - 1):
            excess += values[i] - mean
            if excess < 0 and not tied[i + 1]:
                whole = False
                break
        while rank < end:
            first = rank
            if whole:
                rank = end
            else:
                total = values[rank]
                rank += 1
                while rank < end and tied[rank]:
                    total += values[rank]
                    rank += 1
            weight = float(rank - first)
            while n_new > 0 and sums[n_new - 1] * weight >= total * weights[n_new - 1]:
                n_new -= 1
                total += sums[n_new]
                weight += weights[n_new]
                first = new_blocks[n_new]
            sums[n_new], weights[n_new], new_blocks[n_new] = total, weight, first
            n_new += 1
    new_blocks[n_new] = blocks[n_blocks]
    return n_new
