"""Photos and landmarks to 3D faces in one call each, from Python."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deepmds_keras.checks import check_points
from deepmds_keras.detection.detectors import DETECTORS, default_detector, describe_detector
from deepmds_keras.errors import InputError
from deepmds_keras.landmarks.conversion import convert, scheme_of
from deepmds_keras.landmarks.y_axis import check_y_axis
from deepmds_keras.photos import check_photo, in_colour, open_photo, photo_step
from deepmds_keras.predict.detection import faces_in_photo
from deepmds_keras.predict.estimation import estimate
from deepmds_keras.predict.faces import Face, Found
from deepmds_keras.predict.models import taken
from deepmds_keras.predict.sources import name_faces

if TYPE_CHECKING:
    from PIL import Image


def predict_photo(
    photo: str | Path | Image.Image | np.ndarray,
    *,
    detector: str | None = None,
    model: str | None = None,
    interocular: float | None = None,
) -> list[Face]:
    """3D landmarks of the faces in a photo.

    Args:
        photo: A file, an image of Pillow, or an array `(H, W, 3)` uint8, RGB.
        detector: `"mediapipe"` or `"dlib"`; None takes the first that is installed.
        model: `"lifting"` (None takes it), `"deepmds"`, the paper's method, or a file of
            `LandmarkLifter.save` or `DeepMDS.save`.
        interocular: Millimetres between the outer corners of the eyes, which sets the scale.

    Returns:
        The faces from left to right, as `Face` describes them; none if none is found.

    Raises:
        InputError: The photo cannot be read, or there is no such detector or model.

    Examples:
        >>> import deepmds_keras
        >>> faces = deepmds_keras.predict_photo("family.jpg")  # doctest: +SKIP
        >>> faces[0].shape, faces[0].image_xyz, faces[0].std  # doctest: +SKIP
    """
    detector = detector or default_detector()
    if detector not in DETECTORS:
        raise InputError(f"detector must be one of {', '.join(DETECTORS)}. Received {detector!r}.")
    path = Path(photo) if isinstance(photo, (str, os.PathLike)) else None
    pixels = _pixels(photo) if path is None else open_photo(path)
    landmarks = faces_in_photo(pixels, detector, model)
    if path is not None:
        landmarks = landmarks * photo_step(path)
    found_by = describe_detector(detector, None)
    return _faces(landmarks, scheme_of(landmarks.shape[1]), path, found_by, model, interocular)


def predict_landmarks(
    landmarks: np.ndarray,
    *,
    scheme: str | None = None,
    model: str | None = None,
    interocular: float | None = None,
) -> list[Face]:
    """3D landmarks of faces whose 2D landmarks are known.

    Args:
        landmarks: `(n, L, 2)` or `(L, 2)`, x to the right and y down, as in an image; 51 or 68 of
            iBUG, the paper's 72, or 468 or 478 of MediaPipe.
        scheme: Name of the landmark scheme; None tells it by L.
        model, interocular: As for `predict_photo`.

    Returns:
        A face for each row.

    Raises:
        InputError: Not such landmarks; they are mirrored or upside down; or no such model.
    """
    landmarks = np.asarray(landmarks)
    landmarks = landmarks[None] if landmarks.ndim == 2 else landmarks
    scheme = scheme or scheme_of(landmarks.shape[1])
    check_y_axis(landmarks, scheme, "landmarks")
    target = taken(scheme, model)
    landmarks = check_points(convert(landmarks, scheme, target), "landmarks", 2)
    return _faces(landmarks, target, None, None, model, interocular)


def _faces(landmarks, scheme, path, detector, model, interocular) -> list[Face]:
    if not len(landmarks):
        return []
    names = name_faces("face" if path is None else path.stem, len(landmarks))
    found = Found(path, names, scheme, landmarks, path is not None, detector=detector)
    return estimate(found, model=model, interocular=interocular)


def _pixels(photo: Image.Image | np.ndarray) -> np.ndarray:
    if isinstance(photo, np.ndarray):
        return check_photo(photo)
    return np.array(in_colour(photo))
