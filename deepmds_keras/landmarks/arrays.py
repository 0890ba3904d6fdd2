"""Landmarks as files and users hold them: lists with gaps, coordinates first, fractions."""

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from deepmds_keras.errors import InputError
from deepmds_keras.landmarks import face_sizes, load_scheme
from deepmds_keras.validation import as_numbers

LARGEST_FRACTION = 2  # fraction of the width or height of an image; a face may reach beyond it
# Part of the coordinates that are within the image. In coordinates about the middle of a face it is
# half, as each second one is negative.
_WITHIN = 0.75


def as_faces(points: ArrayLike, name: str, sizes: Collection[int] | None = None) -> np.ndarray:
    """Landmarks of one or more faces as one array.

    Args:
        points: `(n, L, d)` or `(L, d)`, d 2 or 3; or with coordinates first, `(n, d, L)` or
            `(d, L)`, L one of the sizes. In lists and pandas' tables, None and pandas' NA are
            missing landmarks, coordinates or faces.
        name: Name of the file or argument, for the message.
        sizes: Numbers of landmarks; None are `face_sizes`.

    Returns:
        `(n, L, d)` floats, NaN where the input is missing or masked; perhaps the input itself.

    Raises:
        InputError: Another shape, rows of unequal lengths, or anything but numbers.
    """
    if hasattr(points, "to_numpy"):  # pandas' table
        points = points.to_numpy()
    if isinstance(points, np.ndarray) and points.dtype.hasobject and points.ndim:
        points = points.tolist()
    if isinstance(points, (list, tuple)):
        points = _without_none(points)
        if points is None:
            raise InputError(f"{name} must hold landmarks. Received only null.")
    array = as_numbers(points, name)
    sizes = face_sizes() if sizes is None else sizes
    if array.ndim in (2, 3) and array.shape[-1] in sizes and array.shape[-2] in (2, 3):
        array = array.swapaxes(-1, -2)
    if array.ndim not in (2, 3) or array.shape[-1] not in (2, 3):
        raise InputError(
            f"{name} must have shape (n, L, 2) or (L, 2): faces, landmarks, x and y. "
            f"Received {array.shape}."
        )
    return array if array.ndim == 3 else array[None]


def seem_fractions(points: np.ndarray) -> bool:
    """Whether x and y `(n, L, 2)` seem to be fractions of the width and height of an image.

    They differ in unit unless the image is square, which no later check can see: a narrow face
    looks like a turned one. Of MediaPipe's landmarks all that are that small are fractions.
    """
    largest = largest_coordinates(points)
    if not 0 < typical_of(largest) <= LARGEST_FRACTION:
        return False
    known = points[largest <= LARGEST_FRACTION]
    known = known[~np.isnan(known)]
    within = ((known >= 0) & (known <= 1)).mean()
    return points.shape[1] in load_scheme("mediapipe").sizes or bool(within > _WITHIN)


def largest_coordinates(points: np.ndarray) -> np.ndarray:
    """The largest absolute coordinate of each face `(n, L, 2)`; 0 of a gap."""
    return np.where(np.isnan(points), 0, np.abs(points)).max((1, 2), initial=0)


def typical_of(largest: np.ndarray) -> float:
    """The median of `largest_coordinates` without gaps: no stray coordinate of a few faces."""
    seen = largest[largest > 0]
    return float(np.median(seen)) if len(seen) else 0.0


def _without_none(item: Any) -> Any:
    """Lists with NaN for None, and for lists of nothing else, as many as next to them.

    A list of nothing but None is None.
    """
    if item is None or type(item).__name__ == "NAType":  # pandas', which need not be installed
        return None
    if not isinstance(item, (list, tuple)):
        return item
    items = [*map(_without_none, item)]
    known = next((each for each in items if each is not None), None)
    if known is None:
        return None if items else items
    return [_gap(known) if each is None else each for each in items]


def _gap(item: Any) -> Any:
    """NaN in place of each number, in lists that may be of unequal lengths."""
    if isinstance(item, list):
        return [*map(_gap, item)]
    return np.full(np.shape(item), np.nan).tolist()
