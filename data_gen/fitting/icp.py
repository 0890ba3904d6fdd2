"""Rigid registration of one point set to another by iterated closest points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from deepmds_keras.alignment import procrustes
from deepmds_keras.errors import InputError

_MIN_POINTS = 3  # fewer leave the rotation open
_STRETCH = 1.5  # growth of the steps while they keep their direction
_LONGEST = 10.0  # times the motion to the closest points
_SAME_DIRECTION = 0.7  # cosine


@dataclass(frozen=True, eq=False)
class IcpResult:
    """A rigid motion: `target ≈ source @ rotation.T + translation`.

    Attributes:
        rotation: `(3, 3)`, of determinant 1, to be multiplied from the left.
        translation: `(3,)` mm.
        rms: Root mean square distance of the last pairs kept, mm; infinite where too few were.
        overlap: Share of the source points that were kept.
        n_iterations: How often the closest points were looked up.
        converged: Whether the closest points moved no source point farther than the tolerance.
            That may still be the wrong resting place, as after a start too far away; `rms` tells.
    """

    rotation: np.ndarray
    translation: np.ndarray
    rms: float
    overlap: float
    n_iterations: int
    converged: bool


def icp(
    source: np.ndarray,
    target: np.ndarray | KDTree,
    *,
    rotation: np.ndarray | None = None,
    translation: np.ndarray | None = None,
    trim: float = 0.8,
    max_distance: float | None = None,
    max_iterations: int = 100,
    tolerance: float = 1e-3,
) -> IcpResult:
    """Moves a point set onto another, point to point.

    Besl and McKay 1992, doi:10.1109/34.121791, with the farthest pairs left out as in Chetverikov
    et al. 2002, doi:10.1109/ICPR.2002.1047997. While steps keep their direction they go beyond the
    closest points, a simple form of Besl and McKay's acceleration: a third of the steps to the
    same rest.

    Args:
        source: `(m, 3)` mm, the set whose every point looks for its closest in the other: the
            model, rather than the scan with its background.
        target: `(n, 3)` mm, or a tree of them.
        rotation: `(3, 3)` to start from; None is the identity.
        translation: `(3,)` mm to start from; None is zero.
        trim: Share of the source points that are kept, those closest to the target: at most what
            the target shows of the source.
        max_distance: Pairs farther apart, in mm, are not kept either.
        max_iterations: Look-ups after which to give up.
        tolerance: Motion, in mm, of the farthest moved source point that ends the search.

    Raises:
        InputError: Arrays of other shapes, too few points, NaN or infinity, a start that is no
            rotation, or an option out of range.
    """
    source, tree = _points("source", source), _tree(target)
    rotation = np.eye(3) if rotation is None else np.asarray(rotation, float)
    translation = np.zeros(3) if translation is None else np.asarray(translation, float)
    _check_start(rotation, translation)
    if not (0 < trim <= 1 and max_iterations >= 1 and tolerance > 0):
        raise InputError(
            "trim must be in (0, 1], max_iterations at least 1 and tolerance positive. "
            f"Received {trim}, {max_iterations}, {tolerance}."
        )
    reach = np.inf if max_distance is None else max_distance
    if not reach > 0:
        raise InputError(f"max_distance must be positive. Received {max_distance}.")

    n_kept = max(_MIN_POINTS, round(trim * len(source)))
    # Motions are about the middle of the source, where turning and shifting are independent.
    centre = source.mean(0)
    centred = source - centre
    radius = np.sqrt((centred**2).sum(1).mean())
    middle = rotation @ centre + translation
    rms, overlap, converged, last, stretch = np.inf, 0.0, False, np.zeros(6), 1.0
    for n_iterations in range(1, max_iterations + 1):
        moved = centred @ rotation.T + middle
        distance, nearest = tree.query(moved, distance_upper_bound=reach)
        kept = np.argpartition(distance, n_kept - 1)[:n_kept]
        kept = kept[np.isfinite(distance[kept])]
        overlap = len(kept) / len(source)
        if len(kept) < _MIN_POINTS:
            rms = np.inf
            break
        pairs = centred[kept], tree.data[nearest[kept]]
        turned, _, found_middle = procrustes(*pairs, scaling=False, reflection=False)
        found = turned.T
        rms = np.sqrt(((pairs[0] @ found.T + found_middle - pairs[1]) ** 2).sum(1).mean())
        motion = np.linalg.norm(centred @ found.T + found_middle - moved, axis=1).max()
        converged = bool(motion <= tolerance)
        if converged or n_iterations == max_iterations:
            rotation, middle = found, found_middle
            break
        turn = Rotation.from_matrix(found @ rotation.T).as_rotvec()
        shift = found_middle - middle
        step = np.concatenate([turn * radius, shift])
        cosine = step @ last / max(np.linalg.norm(step) * np.linalg.norm(last), 1e-300)
        if cosine > _SAME_DIRECTION:
            stretch = min(stretch * _STRETCH, _LONGEST)
        elif cosine < 0:
            stretch = 1.0
        rotation = Rotation.from_rotvec(stretch * turn).as_matrix() @ rotation
        middle = middle + stretch * shift
        last = step
    return IcpResult(
        rotation=rotation,
        translation=middle - rotation @ centre,
        rms=float(rms),
        overlap=overlap,
        n_iterations=n_iterations,
        converged=converged,
    )


def _points(label: str, points: np.ndarray) -> np.ndarray:
    points = np.asarray(points, float)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < _MIN_POINTS:
        raise InputError(
            f"{label} must be at least {_MIN_POINTS} points, (n, 3). Received {points.shape}."
        )
    if not np.isfinite(points).all():
        raise InputError(f"{label} must be finite. Received NaN or infinity.")
    return points


def _tree(target: np.ndarray | KDTree) -> KDTree:
    if not isinstance(target, KDTree):
        return KDTree(_points("target", target))
    _points("target", target.data)
    return target


def _check_start(rotation: np.ndarray, translation: np.ndarray) -> None:
    if (
        rotation.shape != (3, 3)
        or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
        or not np.linalg.det(rotation) > 0
    ):
        raise InputError(f"rotation must be a (3, 3) rotation matrix. Received {rotation}.")
    if translation.shape != (3,) or not np.isfinite(translation).all():
        raise InputError(f"translation must be three finite numbers. Received {translation}.")
