"""Faces as a landmark detector finds them in photos: any expression and pose, and its errors."""

from __future__ import annotations

import numpy as np

from data_gen.models.expressions import (
    SCAN_EXPRESSIONS,
    sample_expressions,
    scan_expression_weights,
)
from data_gen.models.morphable_model import MorphableModel
from data_gen.views.projections import Cameras, project, sample_perspective_cameras
from deepmds_keras.errors import InputError

# Uniform, to either side, degrees; the field of view is that of a head from afar to arm's length.
YAW, PITCH, ROLL, FIELD_OF_VIEW = 50.0, 25.0, 30.0, 25.0
# Standard deviation of each coordinate. dlib's errors are 2 to 4 % of the 90 mm between the outer
# corners of the eyes, in photos and renders.
DETECTOR_SD_MM = 3.0


def sample_expressive(
    model: MorphableModel, n: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of random faces in any expression.

    Identities are standard normal. Half of the expressions are moments of performances, half are
    held ones, and two thirds of all are at full strength.

    Returns:
        `(n, K)` of identity and `(n, E)` of expression.

    Raises:
        InputError: The model has no expressions whose names are known.
    """
    identity = rng.standard_normal((n, model.n_identity))
    performed = sample_expressions(model, n, rng)
    held = scan_expression_weights(model, rng.choice(SCAN_EXPRESSIONS, n), rng)
    expression = np.where(rng.random((n, 1)) < 0.5, performed, held)
    return identity, expression * np.minimum(1, 3 * rng.random((n, 1)))


def sample_photo_views(
    model: MorphableModel,
    scheme: str,
    n: int,
    rng: np.random.Generator,
    *,
    detector_sd: float | np.ndarray = DETECTOR_SD_MM,
) -> tuple[np.ndarray, np.ndarray, Cameras]:
    """Random faces, one view of each.

    Args:
        model: Morphable model with named expressions and landmarks of the scheme.
        scheme: Landmark scheme.
        n: Number of faces.
        rng: Source of the random numbers.
        detector_sd: Millimetres; of each face, `(n, 1, 1)`, or one number.

    Returns:
        Views `(n, L, 2)` with the detector's errors and landmarks `(n, L, 3)`, both millimetres,
        and the cameras.

    Raises:
        InputError: The model has no such landmarks, or no expressions whose names are known.
    """
    if scheme not in model.landmarks:
        raise InputError(
            f"scheme must be one of {', '.join(model.landmarks)} for {model.name}. "
            f"Received {scheme!r}."
        )
    part = model.restrict(model.landmarks[scheme])
    identity, expression = sample_expressive(model, n, rng)
    landmarks = part.shape(identity, expression)
    cameras = sample_perspective_cameras(
        n, rng, yaw=YAW, pitch=PITCH, roll=ROLL, field_of_view=(0, FIELD_OF_VIEW)
    )
    views = project(landmarks, cameras)
    return views + rng.normal(0, detector_sd, views.shape), landmarks, cameras
