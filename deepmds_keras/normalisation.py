"""The unit of the paper: every face min-max scaled over all its coordinates together."""

from __future__ import annotations

import numpy as np

from deepmds_keras.errors import InputError


def check_points(points: np.ndarray, name: str, n_dimensions: int) -> np.ndarray:
    """Landmarks as a finite float array `(n, L, n_dimensions)`, checked at the door.

    Args:
        points: `(n, L, d)`, or `(L, d)` for one face.
        name: What to call the argument in an error.
        n_dimensions: `d`, 2 for views and 3 for shapes.

    Raises:
        InputError: Wrong shape, NaN or infinity, or a face whose landmarks all coincide or (in
            two or more dimensions) lie on one line, from which no shape can be told.
    """
    points = np.asarray(points)
    if not np.issubdtype(points.dtype, np.number):
        raise InputError(f"{name} must hold numbers. Received dtype {points.dtype}.")
    points = np.asarray(points, float)
    if points.ndim == 2:
        points = points[None]
    if (
        points.ndim != 3
        or not len(points)
        or points.shape[2] != n_dimensions
        or points.shape[1] < 3
    ):
        raise InputError(
            f"{name} must have shape (faces >= 1, landmarks >= 3, {n_dimensions}). "
            f"Received {points.shape}."
        )
    for face in np.flatnonzero(~np.isfinite(points).all((1, 2)))[:1]:
        raise InputError(f"{name} must be finite. Received NaN or infinity in face {face}.")
    centred = points - points.mean(1, keepdims=True)
    spread = np.linalg.svd(np.swapaxes(centred, 1, 2) @ centred, compute_uv=False)
    for face in np.flatnonzero(spread[:, 0] <= 1e-12 * (np.abs(points).max((1, 2)) ** 2))[:1]:
        raise InputError(f"{name} must spread out. Received one point {len(points[face])} times "
                         f"in face {face}.")  # fmt: skip
    for face in np.flatnonzero(spread[:, 1] < 1e-12 * spread[:, 0])[:1]:
        raise InputError(f"{name} must not be collinear. Received a straight line in face {face}.")
    return points


def normalise(points: np.ndarray) -> np.ndarray:
    """Each face min-max scaled to [0, 1] over all its coordinates together.

    The unit of every MSE in the paper's tables. It is not invariant to a shift of one axis alone:
    where the origin of a face model lies changes the unit, which for the BFM is about 207 mm.

    Args:
        points: `(n, L, d)` or `(L, d)`.

    Returns:
        Array of the same shape.

    Raises:
        InputError: A face whose coordinates are all equal, or NaN or infinity.
    """
    points = np.asarray(points, float)
    low, size = unit(points)
    return (points - low) / size


def unit(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smallest coordinate and range of each face, both `(n, 1, 1)`: what `normalise` undoes."""
    points = np.asarray(points, float)
    low = points.min((-2, -1), keepdims=True)
    size = points.max((-2, -1), keepdims=True) - low
    if not (size > 0).all() or not np.isfinite(size).all():
        raise InputError(
            "points must be finite and not all equal within a face. "
            f"Received a face of range {np.min(size)}."
        )
    return low, size
