"""Position and size of landmarks: the unit of the paper, centred faces, their radius."""

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.validation import as_numbers


def normalise(points: np.ndarray) -> np.ndarray:
    """Each face min-max scaled to [0, 1] over all its coordinates together.

    The unit of every MSE in the paper's tables. It is not invariant to a shift of one axis alone:
    where the origin of a face model lies changes the unit, which for the BFM is about 207 mm.

    Args:
        points: `(n, L, d)` or `(L, d)`.

    Returns:
        The same shape, from 0 to 1.

    Raises:
        InputError: A face whose coordinates are all equal or none, another number of dimensions,
            or NaN, infinity or masked numbers.
    """
    points = as_numbers(points, "points")
    low, size = unit(points)
    return (points - low) / size


def unit(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smallest coordinate and range of each face, both `(n, 1, 1)`: what `normalise` undoes."""
    points = as_numbers(points, "points")
    if points.ndim < 2 or 0 in points.shape[-2:]:
        raise InputError(
            f"points must have shape (n, L >= 1, d) or (L, d). Received {points.shape}."
        )
    low = points.min((-2, -1), keepdims=True)
    with np.errstate(over="ignore", invalid="ignore"):  # infinity is refused
        size = points.max((-2, -1), keepdims=True) - low
    if not (size > 0).all() or not np.isfinite(size).all():
        raise InputError(
            "points must be finite and not all equal within a face. "
            f"Received a face of range {np.min(size)}."
        )
    return low, size


def centre(points: np.ndarray) -> np.ndarray:
    """Each face moved so that the mean of its landmarks is 0: `(n, L, d)` → `(n, L, d)`.

    `normalise` depends on the origin. Landmarks of photos, whose origin is a corner of the image,
    are therefore centred first.
    """
    points = as_numbers(points, "points")
    return points - points.mean(-2, keepdims=True)


def centre_and_scale(points: np.ndarray) -> np.ndarray:
    """Each face centred, in the unit of `normalise` once it is: `(n, L, d)` → `(n, L, d)`.

    It depends on neither the origin nor the unit of the points.

    Raises:
        InputError: As for `normalise`.
    """
    centred = centre(points)
    return centred / unit(centred)[1]


def rescaled(points: np.ndarray, axis: int | tuple[int, ...] = (-2, -1)) -> tuple:
    """Points in a unit of 2^k in which their squares neither overflow nor vanish, and k.

    Powers of two scale without rounding. k has the dimensions of the points, those of `axis` 1.
    """
    exponents = np.frexp(np.abs(points).max(axis, keepdims=True, initial=0))[1]
    return np.ldexp(points, -exponents), exponents


def rms_radius(points: np.ndarray) -> np.ndarray:
    """Root mean square distance of the landmarks from their mean: `(n, L, d)` → `(n,)`."""
    offsets, exponents = rescaled(centre(points))
    return np.ldexp(np.sqrt((offsets**2).sum(-1).mean(-1)), exponents[..., 0, 0])


def centre_to_radius_1(points: np.ndarray) -> np.ndarray:
    """Each face centred, in r.m.s. radii: `(n, L, d)` → `(n, L, d)`."""
    return centre(points) / rms_radius(points)[:, None, None]
