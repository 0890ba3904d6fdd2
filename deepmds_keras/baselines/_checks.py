"""What every compared method asks of its input."""

from __future__ import annotations

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.normalisation import check_points


def check_faces(points, name: str, n_dimensions: int, n_landmarks: int) -> np.ndarray:
    """`check_points`, and the number of landmarks.

    Raises:
        InputError: As `check_points`, or another number of landmarks.
    """
    points = check_points(points, name, n_dimensions)
    if points.shape[1] != n_landmarks:
        raise InputError(
            f"{name} must have {n_landmarks} landmarks a face. Received {points.shape[1]}."
        )
    return points


def check_training_faces(views, shapes) -> tuple[np.ndarray, np.ndarray]:
    """Views `(n, L, 2)` and shapes `(n, L, 3)` of the same faces.

    Raises:
        InputError: As `check_points`, or unequal numbers of faces or landmarks.
    """
    views, shapes = check_points(views, "views", 2), check_points(shapes, "shapes", 3)
    if views.shape[:2] != shapes.shape[:2]:
        raise InputError(
            "views and shapes must have the same faces and landmarks. "
            f"Received {views.shape} and {shapes.shape}."
        )
    return views, shapes


def check_fitted(estimator, attribute: str):
    """The attribute that `fit` sets.

    Raises:
        InputError: `fit` was not called.
    """
    if not hasattr(estimator, attribute):
        raise InputError(f"This {type(estimator).__name__} is not trained: call fit first.")
    return getattr(estimator, attribute)
