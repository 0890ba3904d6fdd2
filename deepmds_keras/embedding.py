"""Non-metric multidimensional scaling of dissimilarity matrices: distances in, 3D points out."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable

import numpy as np
from joblib import Parallel, delayed
from sklearn.manifold import MDS

from deepmds_keras.eigenpairs import leading_eigenpairs
from deepmds_keras.errors import InputError

# Regressed distances of near neighbours may fall slightly below zero; beyond this share of the
# largest one the matrix is not one of distances.
_NEGATIVE_SHARE = 0.1
SOLVERS = ("sklearn", "batched")
_FACES_PER_TASK = {"sklearn": 32, "batched": 128}


def embed(
    dissimilarities: np.ndarray,
    n_components: int = 3,
    *,
    solver: str = "sklearn",
    max_iter: int = 300,
    eps: float = 1e-6,
    n_jobs: int | None = None,
    progress: Callable[[int], object] | None = None,
    return_stress: bool = False,
) -> np.ndarray | tuple[np.ndarray, np.ndarray]:
    """Points whose distances have the order of the dissimilarities (paper, equation of c_2).

    scikit-learn's non-metric `MDS` (SMACOF, Kruskal's stress-1) from a classical-scaling start,
    as the `mdscale` of the released code starts. Being non-metric it loses the scale, which is put
    back by least squares; points are centred and turned to their principal axes, of the sign that
    `classical_scaling` gives them. Which of the two mirror images that makes says nothing about the
    face: distances cannot tell, see `DeepMDS.predict`.

    Args:
        dissimilarities: `(n, L, L)` or `(L, L)`, symmetric. The diagonal is not read and slightly
            negative values, as a regression may give for near neighbours, are folded.
        n_components: Dimensions of the embedding.
        solver: `"sklearn"`, or `"batched"`, which makes the same steps compiled by numba (extra
            `fast`), many times faster, see `compiled_mds`; without numba it is scikit-learn's too.
        max_iter: Most SMACOF iterations for a face.
        eps: Relative decrease of stress at which to stop.
        n_jobs: Processes, or threads where the solver is compiled; None or 1 works in this one,
            -1 uses every core.
        progress: Called with the number of faces just done.
        return_stress: Whether to return stress-1 too.

    Returns:
        `(n, L, n_components)` or `(L, n_components)`; with `return_stress` also `(n,)` stress-1.

    Raises:
        InputError: Not square, not symmetric, NaN or infinity, clearly negative, or all zero; or
            an unknown solver.
    """
    if solver not in SOLVERS:
        raise InputError(f"solver must be one of {', '.join(SOLVERS)}. Received {solver!r}.")
    dissimilarities = np.asarray(dissimilarities)
    _check_shape(dissimilarities.shape)
    single = dissimilarities.ndim == 2
    matrices = dissimilarities[None] if single else dissimilarities
    step = _FACES_PER_TASK[solver]
    tasks = [slice(first, first + step) for first in range(0, len(matrices), step)]
    # Compiled code runs beside other threads: nothing has to be sent to another process.
    prefer = "threads" if solver == "batched" and compiled_solver() else None
    done = Parallel(n_jobs if len(tasks) > 1 else 1, prefer=prefer, return_as="generator")(
        delayed(_embed_faces)(matrices[task], n_components, solver, max_iter, eps) for task in tasks
    )
    points, stress = [], []
    for some_points, some_stress in done:
        points.append(some_points)
        stress.append(some_stress)
        if progress is not None:
            progress(len(some_points))
    points, stress = np.concatenate(points), np.concatenate(stress)
    if single:
        points, stress = points[0], stress[0]
    return (points, stress) if return_stress else points


def pairwise_distances(points: np.ndarray) -> np.ndarray:
    """Euclidean distances of all pairs of points: `(…, L, d)` → `(…, L, L)`, double precision."""
    points = np.asarray(points, float)
    return np.linalg.norm(points[..., :, None, :] - points[..., None, :, :], axis=-1)


def classical_scaling(dissimilarities: np.ndarray, n_components: int = 3) -> np.ndarray:
    """Classical (Torgerson) scaling of each matrix: `(n, L, L)` → `(n, L, n_components)`.

    Components of negative eigenvalues, which no Euclidean distances have, are left at zero. The
    sign of a component, which distances leave open, is such that the first landmark far out on it
    has a positive coordinate.
    """
    values, vectors = leading_eigenpairs(_doubly_centred(dissimilarities), n_components)
    return _with_signs(vectors * np.sqrt(np.maximum(values, 0))[:, None])


def metric_embed(dissimilarities: np.ndarray, n_components: int = 3) -> np.ndarray:
    """Points whose distances are nearest to the dissimilarities, to compare with `embed`.

    scikit-learn's metric `MDS` from the same start, with the same limits: `(n, L, L)` →
    `(n, L, n_components)`, turned as it comes.

    Raises:
        InputError: As for `embed`.
    """
    matrices = check_dissimilarities(dissimilarities)
    starts = classical_scaling(matrices, n_components)
    found = (sklearn_mds(*face, metric=True)[0] for face in zip(matrices, starts, strict=True))
    return np.array([*found])


@functools.cache
def compiled_solver() -> Callable | None:
    """Return `compiled_mds`, None where numba cannot be imported, which takes it a second."""
    try:
        from deepmds_keras.compiled_mds import compiled_mds
    except ImportError:
        return None
    return compiled_mds


def check_dissimilarities(dissimilarities: np.ndarray) -> np.ndarray:
    """Matrices as `embed` uses them: `(n, L, L)`, exactly symmetric, not negative, diagonal 0."""
    matrices = np.array(dissimilarities, float)
    _check_shape(matrices.shape)
    if matrices.ndim == 2:
        matrices = matrices[None]
    if not np.isfinite(matrices).all():
        raise InputError("dissimilarities must be finite. Received NaN or infinity.")
    diagonal = np.arange(matrices.shape[1])
    matrices[:, diagonal, diagonal] = 0
    largest = np.abs(matrices).max((1, 2))
    if (largest == 0).any():
        raise InputError("dissimilarities must not all be zero off the diagonal. Received zeros.")
    asymmetry = (np.abs(matrices - np.swapaxes(matrices, 1, 2)).max((1, 2)) / largest).max()
    if asymmetry > 1e-5:
        raise InputError(
            "dissimilarities must be symmetric. "
            f"Received a matrix that is off by {asymmetry:.1e} of its largest entry."
        )
    if (matrices.min((1, 2)) < -_NEGATIVE_SHARE * largest).any():
        raise InputError(
            f"dissimilarities must not be negative. Received {matrices.min():.3g} "
            f"where the largest is {matrices.max():.3g}."
        )
    return np.abs((matrices + np.swapaxes(matrices, 1, 2)) / 2)


def _check_shape(shape: tuple[int, ...]) -> None:
    if len(shape) not in (2, 3) or 0 in shape or shape[-1] != shape[-2] or shape[-1] < 3:
        raise InputError(
            "dissimilarities must be square matrices (L, L) or (n, L, L) with L >= 3 and n > 0. "
            f"Received shape {shape}."
        )


def _doubly_centred(dissimilarities: np.ndarray) -> np.ndarray:
    """Gram matrices of the points, about their mean, that have these distances."""
    squared = np.square(np.asarray(dissimilarities, float))
    rows = squared.mean(-1, keepdims=True)
    return -0.5 * (squared - rows - np.swapaxes(rows, -1, -2) + rows.mean(-2, keepdims=True))


def _with_signs(points: np.ndarray) -> np.ndarray:
    """Points `(..., L, k)`, each axis turned so that the first landmark far out on it is positive.

    The sign of an eigenvector hangs on rounding, hence on the processor. So would that of the
    farthest landmark in a symmetric face, where two are equally far out on either side. Of all that
    are at least 0.6 times as far out as the farthest, the first is the same on any processor.
    """
    sizes = np.abs(points)
    first = (sizes >= 0.6 * sizes.max(-2, keepdims=True)).argmax(-2)
    return points * np.sign(np.take_along_axis(points, first[..., None, :], -2))


def _embed_faces(matrices, n_components, solver, max_iter, eps):
    matrices = check_dissimilarities(matrices)
    solve = (solver == "batched" and compiled_solver()) or sklearn_mds
    points, stress = classical_scaling(matrices, n_components), np.empty(len(matrices))
    for face, matrix in enumerate(matrices):
        points[face], stress[face], _ = solve(matrix, points[face], max_iter, eps)
    points -= points.mean(1, keepdims=True)
    points = points @ np.swapaxes(np.linalg.svd(points, full_matrices=False)[2], 1, 2)
    points = _with_signs(points)
    return points * _scales(points, matrices)[:, None, None], stress


def _scales(points: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Factor of each face that brings its distances nearest to the given ones."""
    squares = np.square(points).sum(-1)
    distances = squares[:, :, None] + squares[:, None] - 2 * points @ np.swapaxes(points, 1, 2)
    np.sqrt(np.maximum(distances, 0, out=distances), out=distances)
    # Of points about their mean, the sum of all squared distances.
    total = 2 * points.shape[1] * squares.sum(1)
    return np.einsum("nij,nij->n", distances, matrices) / total


def sklearn_mds(
    dissimilarities: np.ndarray,
    start: np.ndarray,
    max_iter: int = 300,
    eps: float = 1e-6,
    *,
    metric: bool = False,
) -> tuple[np.ndarray, float, int]:
    """Points, stress-1 and iterations of one face, as `compiled_mds`, by scikit-learn."""
    scaling = precomputed_mds(start.shape[1], metric, n_init=1, max_iter=max_iter, eps=eps)
    points = scaling.fit_transform(dissimilarities, init=start)
    return points, scaling.stress_, scaling.n_iter_


def precomputed_mds(n_components: int, metric: bool = False, **options) -> MDS:
    """scikit-learn's `MDS` of dissimilarities, with Kruskal's stress-1.

    Args:
        n_components: Dimensions of the embedding.
        metric: Whether the distances are to have the size of the dissimilarities, or their order.
        **options: Of `MDS`.
    """
    # scikit-learn renamed two arguments in 1.8; Python 3.10 only has 1.7.
    if "metric_mds" in inspect.signature(MDS).parameters:
        kind = {"metric_mds": metric, "metric": "precomputed", "init": "random"}
    else:
        kind = {"metric": metric, "dissimilarity": "precomputed"}
    return MDS(n_components, normalized_stress=True, **kind, **options)
