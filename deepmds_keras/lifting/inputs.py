"""Prepares views of faces for the lifting network."""

from typing import NamedTuple

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.validation import as_array, as_numbers

LEAST_VISIBLE = 6
_LARGEST_SD = 1e18  # relative to the radius: squares in single precision end at 1.8e19
FLAT = 1e-6  # of `flatness`: less is rounding


class Views(NamedTuple):
    """Centred views of unit root mean square radius, and how they were centred and scaled."""

    views: np.ndarray  # (n, 2, L) float32, 0 where not visible
    visible: np.ndarray  # (n, L) float32, 1 or 0
    sd: np.ndarray | None  # (n, L) float32, in the unit of the views
    centre: np.ndarray  # (n, 2)
    radius: np.ndarray  # (n, 1)

    @property
    def points(self) -> np.ndarray:
        """The views, NaN where not visible: `(n, L, 2)`."""
        return np.where(self.visible[:, None], self.views, np.nan).swapaxes(1, 2)


def prepare_views(points, n_landmarks: int, visible=None, landmark_sd=None) -> Views:
    """Check views, mark what is missing, centre and scale what is visible.

    Args:
        points: `(n, L, 2)` or `(L, 2)`, NaN or masked where a landmark is missing.
        n_landmarks: L.
        visible: `(n, L)` or `(L,)` bool, False where a landmark is missing.
        landmark_sd: Standard deviation of the errors of a coordinate, in the unit of the points:
            one number, one for each face `(n,)`, or one for each landmark, `(n, L)` or, of one
            face, `(L,)`; None if unknown. That of a missing landmark may be anything.

    Raises:
        InputError: Another number of landmarks, infinity, an unusable `visible` or `landmark_sd`,
            fewer than six visible landmarks, or all of them on one line.
    """
    points = _check_points(points, n_landmarks)
    known = np.ones(points[:, 0].shape, bool)
    if visible is not None:
        known &= as_visible(visible, known.shape)
    if not np.isfinite(points).all():
        infinite = (known & np.isinf(points).any(1)).any(1)
        _refuse(infinite, "views must be finite or NaN", lambda _: "infinity")
        known &= ~np.isnan(points).any(1)
    counts = known.sum(1)
    _refuse(
        counts < LEAST_VISIBLE,
        f"views must have at least {LEAST_VISIBLE} visible landmarks",
        lambda face: f"{counts[face]}",
    )
    if not known.all():
        points = np.where(known[:, None], points, 0)
    views, middle, radius = standardise(points, known)
    _refuse(
        ~(flatness(views, counts) > FLAT),
        f"views must have at least {LEAST_VISIBLE} visible landmarks that are not on one line",
        lambda face: "a straight line or a point",
    )
    sd = None if landmark_sd is None else _relative_sd(landmark_sd, known, radius)
    views = np.asarray(views, np.float32)
    return Views(views, np.asarray(known, np.float32), sd, middle, radius)


def standardise(points, visible):
    """Centre and scale what is visible, `(n, L)`, of points `(n, 2, L)`.

    Returns:
        `(n, 2, L)` views of unit root mean square radius, 0 where not visible; their centres
        `(n, 2)` and radii `(n, 1)` in the unit of the points.
    """
    seen = visible[:, None]
    counts = visible.sum(1, keepdims=True)
    middle = (points @ np.swapaxes(seen, 1, 2))[:, :, 0] / counts
    centred = (points - middle[:, :, None]) * seen
    largest = np.abs(centred).max((1, 2), keepdims=True)
    centred /= np.where(largest > 0, largest, 1)  # so that squares neither overflow nor vanish
    flat = centred.reshape(len(centred), 1, 2 * centred.shape[2])
    relative = np.sqrt((flat @ np.swapaxes(flat, 1, 2)) / counts[:, :, None])
    centred /= np.where(relative > 0, relative, 1)
    return centred, middle, (largest * relative)[:, :, 0]


def flatness(views, counts):
    """Variance of views `(n, 2, L)` across a line, relative to the whole; 0 on one line.

    They are as `standardise` returns them, with so many visible landmarks each.
    """
    x, y = views[:, 0], views[:, 1]
    pairs = ((x, x), (y, y), (x, y))
    xx, yy, xy = (np.matmul(a[:, None], b[:, :, None])[:, 0, 0] / counts for a, b in pairs)
    return xx * yy - xy * xy


def _check_points(points, n_landmarks):
    points = as_numbers(points, "views")
    if points.ndim == 2:
        points = points[None]
    if points.ndim != 3 or points.shape[1:] != (n_landmarks, 2) or not len(points):
        raise InputError(
            f"views must have shape (n >= 1, {n_landmarks}, 2). Received {points.shape}."
        )
    return np.ascontiguousarray(np.swapaxes(points, 1, 2))


def as_visible(visible, shape: tuple[int, int]) -> np.ndarray:
    """Which landmarks are visible, `(n, L)` bool: none of those that are masked."""
    visible = np.ma.filled(as_array(visible, "visible"), False)
    try:
        return np.broadcast_to(visible.astype(bool, casting="safe"), shape)
    except (TypeError, ValueError):
        raise InputError(
            f"visible must be bool of shape {shape}. "
            f"Received {visible.dtype} of shape {visible.shape}."
        ) from None


def as_landmark_sd(landmark_sd, known: np.ndarray) -> np.ndarray:
    """One number, one of each face `(n,)`, or of each landmark, as `(n, L)`.

    Raises:
        InputError: Another shape, or one of the `(n, L)` known landmarks is negative or not finite.
    """
    sd = as_numbers(landmark_sd, "landmark_sd")
    if sd.ndim == 1:
        sd = sd[None] if (1, len(sd)) == known.shape else sd[:, None]
    try:
        sd = np.broadcast_to(sd, known.shape)
    except ValueError:
        raise InputError(
            f"landmark_sd must be one number, ({len(known)},) or {known.shape}. "
            f"Received shape {np.shape(landmark_sd)}."
        ) from None
    counted = sd[known]
    if not (np.isfinite(counted).all() and (counted >= 0).all()):
        raise InputError(
            "landmark_sd must be finite and not negative. "
            f"Received numbers from {counted.min()} to {counted.max()}."
        )
    return sd


def _relative_sd(landmark_sd, known, radius):
    relative = as_landmark_sd(landmark_sd, known) / radius
    _refuse(
        (known & (relative > _LARGEST_SD)).any(1),
        f"landmark_sd must be at most {_LARGEST_SD:.0e} radii of the face; leave out landmarks "
        "whose errors are not known, by visible or as NaN",
        lambda face: f"{relative[face][known[face]].max():.1e} radii",
    )
    # Of a missing landmark: zero times infinity or NaN would not vanish.
    usable = (relative >= 0) & (relative <= _LARGEST_SD)
    return np.asarray(np.where(usable, relative, 0), np.float32)


def _refuse(bad, needed, received):
    for face in np.flatnonzero(bad)[:1]:
        raise InputError(f"{needed}. Received {received(face)} in face {face}.")
