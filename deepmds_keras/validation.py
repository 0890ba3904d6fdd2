"""Checks of input that every method shares: input is validated once, where it enters."""

import functools
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from deepmds_keras.errors import InputError

_FLAT = 1e-5  # relative depth of a shape below which its affine camera is undetermined


def as_array(values: ArrayLike, name: str) -> np.ndarray:
    """An array, masked if the input is; the input itself if it is one.

    Raises:
        InputError: Lists of unequal lengths.
    """
    try:
        return values if isinstance(values, np.ma.MaskedArray) else np.asarray(values)
    except ValueError:
        raise InputError(f"{name} must be one array. Received rows of unequal lengths.") from None


def as_numbers(points: ArrayLike, name: str) -> np.ndarray:
    """An array of floats, NaN where the input is masked; the input itself if it is one.

    Raises:
        InputError: Lists of unequal lengths, or anything but real numbers.
    """
    array = as_array(points, name)
    if array.dtype.kind not in "fiu":
        raise InputError(f"{name} must hold numbers. Received dtype {array.dtype}.")
    return np.ma.filled(array.astype(float, copy=False), np.nan)


def check_points(points: np.ndarray, name: str, n_dimensions: int) -> np.ndarray:
    """Landmarks as a validated finite float array `(n, L, n_dimensions)`.

    Args:
        points: `(n, L, d)`, or `(L, d)` for one face.
        name: Name of the argument in an error message.
        n_dimensions: `d`, 2 for views and 3 for shapes.

    Raises:
        InputError: Wrong shape, or a face with one of the faults of `find_faults`.
    """
    points = as_numbers(points, name)
    points = points[None] if points.ndim == 2 else points
    shape = points.shape
    if len(shape) != 3 or shape[0] < 1 or shape[1] < 3 or shape[2] != n_dimensions:
        raise InputError(
            f"{name} must have shape (faces >= 1, landmarks >= 3, {n_dimensions}). "
            f"Received {shape}."
        )
    for face, fault in find_faults(points).items():
        raise InputError(f"{name} {fault} in face {face}.")
    return points


def find_faults(points: np.ndarray) -> dict[int, str]:
    """Faces of `(n, L, d)` points from whose landmarks no shape can be estimated.

    Returns:
        Number of each such face, 0-based and ascending, → the reason: NaN or infinity, landmarks
        that all coincide or (in two or more dimensions) lie on one line.
    """
    finite = np.isfinite(points).all((1, 2))
    # In units of the largest coordinate, so that squares neither overflow nor vanish.
    points = np.where(finite[:, None, None], points, 0)
    size = np.abs(points).max((1, 2), keepdims=True)
    scaled = points / np.where(size > 0, size, 1)
    centred = scaled - scaled.mean(1, keepdims=True)
    spread = np.linalg.svd(np.swapaxes(centred, 1, 2) @ centred, compute_uv=False)
    one_point = spread[:, 0] <= 1e-24  # squares: as far as rounding lets faces lie from 0
    line = spread[:, 1] < 1e-12 * spread[:, 0]
    faults = {}
    for face in np.flatnonzero(~finite | one_point | line).tolist():
        if not finite[face]:
            faults[face] = "must be finite. Received NaN or infinity"
        elif one_point[face]:
            faults[face] = f"must not be degenerate: all {points.shape[1]} landmarks coincide"
        else:
            faults[face] = "must not be degenerate: all landmarks lie on one line"
    return faults


def of_one_or_many(shapes: np.ndarray, views: np.ndarray) -> np.ndarray:
    """The only one of the shapes `(n, L, 3)` if one view `(L, 2)` was given, else all of them."""
    return shapes[0] if np.ndim(views) == 2 else shapes


def check_faces(points, name: str, n_dimensions: int, n_landmarks: int) -> np.ndarray:
    """`check_points`, which also refuses another number of landmarks."""
    check_n_landmarks(n_landmarks)
    points = check_points(points, name, n_dimensions)
    if points.shape[1] != n_landmarks:
        raise InputError(
            f"{name} must have {n_landmarks} landmarks per face. Received {points.shape[1]}."
        )
    return points


def check_n_landmarks(n_landmarks: int, least: int = 3) -> None:
    """Raise InputError unless the number of landmarks is whole and at least 3, or `least`."""
    check_whole(n_landmarks, "n_landmarks", least)


def check_whole(value: object, name: str, least: int = 1) -> None:
    """Raise InputError unless a parameter is a whole number, NumPy's included, of at least that."""
    if not isinstance(value, Integral) or isinstance(value, bool) or value < least:
        raise InputError(f"{name} must be a whole number of at least {least}. Received {value!r}.")


def check_n_jobs(n_jobs: object) -> None:
    """Raise InputError unless a number of processes is None or whole, as joblib counts them."""
    if n_jobs is not None and (not isinstance(n_jobs, Integral) or not n_jobs):
        raise InputError(f"n_jobs must be a whole number other than 0. Received {n_jobs!r}.")


def check_number(value: object, name: str, *, zero: bool = False) -> None:
    """Raise InputError unless a parameter is a finite positive number; `zero` may be allowed."""
    number = float(value) if isinstance(value, Real) and not isinstance(value, bool) else np.nan
    if not (0 < number < np.inf or (zero and number == 0)):
        needed = "finite and not negative" if zero else "finite and positive"
        raise InputError(f"{name} must be {needed}. Received {value!r}.")


def check_views_and_shapes(views, shapes) -> tuple[np.ndarray, np.ndarray]:
    """Views `(n, L, 2)` and shapes `(n, L, 3)` of the same faces.

    Raises:
        InputError: As for `check_points`, or unequal numbers of faces or landmarks.
    """
    views, shapes = check_points(views, "views", 2), check_points(shapes, "shapes", 3)
    if views.shape[:2] != shapes.shape[:2]:
        raise InputError(
            "views and shapes must have the same faces and landmarks. "
            f"Received {views.shape} and {shapes.shape}."
        )
    return views, shapes


def check_face_model(mean, basis_times_sd) -> tuple[np.ndarray, np.ndarray]:
    """Mean `(L, 3)` of a face model at its landmarks, and components `(K, L, 3)`, float64.

    Raises:
        InputError: As for `check_basis`, or a mean that is unusable or flat, of which no camera is
            known.
    """
    means = check_points(mean, "mean", 3)
    if len(means) > 1:
        raise InputError(f"mean must be one face, (landmarks, 3). Received {len(means)} faces.")
    mean = means[0]
    extents = np.linalg.svd(mean - mean.mean(0), compute_uv=False)
    if extents[2] < _FLAT * extents[0]:
        raise InputError("mean must not be flat. Received landmarks in one plane.")
    return mean, check_basis(basis_times_sd, "basis_times_sd", len(mean))


def check_basis(basis, name: str, n_landmarks: int, least: int = 1) -> np.ndarray:
    """Components of a face model at its landmarks, `(K, L, 3)` float64.

    Raises:
        InputError: Another shape, fewer components, or NaN, infinity or masked numbers.
    """
    basis = as_numbers(basis, name)
    usable = basis.ndim == 3 and len(basis) >= least and basis.shape[1:] == (n_landmarks, 3)
    if not usable or not np.isfinite(basis).all():
        raise InputError(
            f"{name} must be finite, of shape (components >= {least}, {n_landmarks}, 3). "
            f"Received shape {basis.shape}."
        )
    return basis


def check_still_of(trained: object, parameter: object, name: str = "n_landmarks") -> None:
    """Raise InputError if a parameter is no longer that with which a model was trained."""
    if parameter != trained:
        raise InputError(
            f"{name} must be {trained}, with which the model was trained; train it again for "
            f"others. Received {parameter!r}."
        )


def check_fitted(estimator: object, attribute: str, setters: str = "fit") -> Any:
    """The attribute that `fit`, or another of `setters`, sets.

    Raises:
        InputError: None of them was called. If scikit-learn is installed, the error is also its
            `NotFittedError`.
    """
    if not hasattr(estimator, attribute):
        raise _not_fitted_error()(
            f"This {type(estimator).__name__} is not trained: call {setters} first."
        )
    return getattr(estimator, attribute)


@functools.cache
def _not_fitted_error() -> type[InputError]:
    try:
        from sklearn.exceptions import NotFittedError
    except ImportError:
        return InputError
    # A class that is made here has no name by which pickle would find it.
    pickled = {"__reduce__": lambda error: (_not_fitted, error.args)}
    return type("NotFittedError", (InputError, NotFittedError), pickled)


def _not_fitted(*arguments: str) -> InputError:
    return _not_fitted_error()(*arguments)
