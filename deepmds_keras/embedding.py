"""The paper's embedding: scikit-learn's non-metric MDS turns distances into 3D points."""

from collections.abc import Callable

import numpy as np
from joblib import Parallel, delayed
from scipy.spatial.distance import pdist, squareform
from sklearn.manifold import MDS

from deepmds_keras.errors import InputError, check_choice, needs
from deepmds_keras.geometry.classical_scaling import classical_scaling, with_signs
from deepmds_keras.geometry.units import rescaled
from deepmds_keras.validation import as_numbers, check_n_jobs, check_number, check_whole

SOLVERS = ("sklearn", "numba")
# Estimated distances of near neighbours may fall slightly below zero; beyond this share of the
# largest distance, the matrix does not hold distances.
_NEGATIVE_SHARE = 0.1
_SMALLEST = 1e-12  # stands for a distance of 0 where the largest is 0.5 to 1


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

    Non-metric MDS (SMACOF, Kruskal's stress-1) starting from classical scaling, as `mdscale` does
    in the released code. The scale is lost and restored by least squares; points are centred and
    rotated to their principal axes, with the signs of `classical_scaling`. Distances do not
    determine which of the two mirror images the face is, and neither does the result.

    Args:
        dissimilarities: `(n, L, L)` or `(L, L)`, symmetric, in any unit. The diagonal is ignored.
            Slightly negative values, which a regression may give for near neighbours, lose their
            sign; 0 is the smallest distance, not a missing one.
        n_components: Dimensions of the embedding.
        solver: `"sklearn"`, scikit-learn's `MDS`, or `"numba"`, which takes the same steps compiled
            (extra `fast`), many times faster, see `compiled_mds`. Results agree to rounding.
        max_iter: Maximum number of SMACOF iterations per face.
        eps: Relative decrease of stress at which to stop.
        n_jobs: Number of processes, or threads if the solver is compiled; None or 1 uses this one
            alone, -1 every core.
        progress: Called with the number of faces just done.
        return_stress: Whether to return stress-1 too.

    Returns:
        `(n, L, n_components)` or `(L, n_components)`; with `return_stress` also stress-1, `(n,)` or
        a number.

    Raises:
        InputError: Not square, not symmetric, masked, NaN or infinity, clearly negative, or all
            zero; or an unknown solver, a parameter out of range or more dimensions than landmarks.
        MissingPackageError: `"numba"` without numba.
    """
    solve, step, prefer = _choose(solver)
    matrices = check_dissimilarities(dissimilarities)
    check_whole(n_components, "n_components")
    if n_components > matrices.shape[-1]:
        raise InputError(
            f"n_components must be at most {matrices.shape[-1]}, the number of landmarks. "
            f"Received {n_components}."
        )
    check_whole(max_iter, "max_iter")
    check_number(eps, "eps", zero=True)
    check_n_jobs(n_jobs)
    tasks = [slice(first, first + step) for first in range(0, len(matrices), step)]
    done = Parallel(n_jobs if len(tasks) > 1 else 1, prefer=prefer, return_as="generator")(
        delayed(_embed_faces)(matrices[task], n_components, solve, max_iter, eps) for task in tasks
    )
    points, stress = np.empty((*matrices.shape[:2], n_components)), np.empty(len(matrices))
    for task, embedded in zip(tasks, done, strict=True):
        points[task], stress[task] = embedded
        if progress is not None:
            progress(len(embedded[0]))
    if np.ndim(dissimilarities) == 2:
        points, stress = points[0], stress[0]
    return (points, stress) if return_stress else points


def sklearn_mds(
    dissimilarities: np.ndarray,
    start: np.ndarray,
    max_iter: int = 300,
    eps: float = 1e-6,
    *,
    metric: bool = False,
) -> tuple[np.ndarray, float, int]:
    """scikit-learn's `MDS` of one face, with the arguments and results of `compiled_mds`.

    `metric` fits the dissimilarities themselves, not only their order.
    """
    mds = MDS(
        n_components=start.shape[1],
        metric="precomputed",  # what the dissimilarities are
        metric_mds=metric,  # the paper's is False: only the order counts; metric=False before 1.8
        init="random",  # the points given to fit_transform
        n_init=1,
        max_iter=max_iter,
        eps=eps,
        normalized_stress=True,
    )
    points = mds.fit_transform(dissimilarities, init=start)
    return points, mds.stress_, mds.n_iter_


def metric_embed(dissimilarities: np.ndarray, n_jobs: int | None = None) -> np.ndarray:
    """Metric MDS, for comparison with `embed`.

    scikit-learn's `MDS` from the same start: `(n, L, L)` → `(n, L, 3)`, in any orientation.
    `n_jobs` is the number of processes, as for `embed`.
    """
    matrices = check_dissimilarities(dissimilarities)
    starts = classical_scaling(matrices)
    solve = delayed(sklearn_mds)
    faces = (solve(*face, metric=True) for face in zip(matrices, starts, strict=True))
    return np.array([points for points, *_ in Parallel(n_jobs)(faces)])


def check_dissimilarities(dissimilarities: np.ndarray) -> np.ndarray:
    """Matrices as `embed` uses them: `(n, L, L)`, exactly symmetric, not negative, diagonal 0."""
    matrices, shape = as_numbers(dissimilarities, "dissimilarities"), np.shape(dissimilarities)
    if len(shape) not in (2, 3) or 0 in shape or shape[-1] != shape[-2] or shape[-1] < 3:
        raise InputError(
            "dissimilarities must be square matrices (L, L) or (n, L, L) with L >= 3 and n > 0. "
            f"Received shape {shape}."
        )
    matrices = matrices.reshape(-1, *shape[-2:]).copy()
    diagonal = np.arange(shape[-1])
    matrices[:, diagonal, diagonal] = 0
    if not np.isfinite(matrices).all():
        raise InputError("dissimilarities must be finite. Received NaN, infinity or masked values.")
    largest = np.abs(matrices).max((1, 2))
    if (largest == 0).any():
        raise InputError("dissimilarities must not all be zero off the diagonal. Received zeros.")
    off = (np.abs(matrices - np.swapaxes(matrices, 1, 2)).max((1, 2)) / largest).max()
    if off > 1e-5:
        raise InputError(
            f"dissimilarities must be symmetric. They differ by {off:.1e} of the largest."
        )
    if (matrices.min((1, 2)) < -_NEGATIVE_SHARE * largest).any():
        raise InputError(
            f"dissimilarities must not be negative. Received {matrices.min():.3g} "
            f"where the largest is {matrices.max():.3g}."
        )
    return np.abs((matrices + np.swapaxes(matrices, 1, 2)) / 2)


def _embed_faces(matrices, n_components, solve, max_iter, eps):
    # Solvers have constants in the unit of distances, and take 0 for missing.
    scaled, _ = rescaled(matrices)
    scaled[(scaled == 0) & ~np.eye(matrices.shape[1], dtype=bool)] = _SMALLEST
    points, stress = classical_scaling(scaled, n_components), np.empty(len(matrices))
    for face, matrix in enumerate(scaled):
        # Where landmarks that differ start at one place, rounding would decide where they go.
        if ((pdist(points[face]) < 1e-7) & (squareform(matrix, checks=False) > 1e-6)).any():
            points[face] += 1e-3 * np.random.default_rng(0).standard_normal(points[face].shape)
        points[face], stress[face], _ = solve(matrix, points[face], max_iter, eps)
    points -= points.mean(1, keepdims=True)
    points = points @ np.swapaxes(np.linalg.svd(points, full_matrices=False)[2], 1, 2)
    points = with_signs(points)
    return points * _scales(points, matrices)[:, None, None], stress


def _scales(points: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Scale of each face for which its distances fit the given ones best (least squares)."""
    squares = np.square(points).sum(-1)
    distances = squares[:, :, None] + squares[:, None] - 2 * points @ np.swapaxes(points, 1, 2)
    np.sqrt(np.maximum(distances, 0, out=distances), out=distances)
    # The sum of all squared distances, computed from the points about their mean.
    total = 2 * points.shape[1] * squares.sum(1)
    return np.einsum("nij,nij->n", distances, matrices) / total


def _choose(solver: str) -> tuple[Callable, int, str | None]:
    """The function that embeds a face, faces per task, and whether tasks run in threads."""
    check_choice(solver, "solver", SOLVERS)
    if solver == "sklearn":
        return sklearn_mds, 32, None
    with needs('numba, which solver="numba" needs,', "fast"):
        from deepmds_keras.compiled_mds import compiled_mds
    return compiled_mds, 128, "threads"  # compiled code releases the interpreter lock
