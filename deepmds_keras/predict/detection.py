"""Landmarks of every face in photos, by either detector, in the order that the method takes."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from deepmds_keras.detection import mediapipe_landmarks
from deepmds_keras.detection.dlib_landmarks import DlibLandmarks
from deepmds_keras.errors import InputError
from deepmds_keras.landmarks.conversion import convert
from deepmds_keras.photos import open_photo

DETECTORS = ("dlib", "mediapipe")
SCHEME = "ibug51"
_HELP = {
    "dlib": "try --detector mediapipe, or give the landmarks instead of the photo",
    "mediapipe": "try --detector dlib, or give the landmarks instead of the photo",
}


def faces_in_photos(
    photos: list[Path], detector: str, python: Path | None
) -> list[np.ndarray | InputError]:
    """What is found in each photo.

    Args:
        photos: Files.
        detector: One of `DETECTORS`.
        python: Interpreter of the environment with MediaPipe; dlib needs none.

    Returns:
        For each photo `(n, 51, 2)` pixels, x right and y down, of all its faces, the largest first;
        or why there is none.

    Raises:
        InputError: The detector itself cannot be used.
    """
    find = _by_dlib if detector == "dlib" else _by_mediapipe
    opened = [_opened(path) for path in photos]
    found = iter(find([photo for photo in opened if not isinstance(photo, InputError)], python))
    results: list[np.ndarray | InputError] = []
    for path, photo in zip(photos, opened, strict=True):
        faces = photo if isinstance(photo, InputError) else next(found)
        if not len(faces.args if isinstance(faces, InputError) else faces):
            faces = InputError(f"{path}: no face found by {detector}; {_HELP[detector]}.")
        results.append(faces)
    return results


def _opened(path: Path) -> np.ndarray | InputError:
    try:
        return open_photo(path)
    except InputError as error:
        return error


def _by_dlib(photos: list[np.ndarray], _: None) -> list[np.ndarray]:
    return [convert(_dlib().detect_all(photo), "ibug68", SCHEME) for photo in photos]


def _by_mediapipe(photos: list[np.ndarray], python: Path) -> list[np.ndarray]:
    if not photos:
        return []
    meshes = mediapipe_landmarks.detect_all(photos, python)
    return [convert(mesh[..., :2].astype(float), "mediapipe", SCHEME) for mesh in meshes]


@cache
def _dlib() -> DlibLandmarks:
    """One for each process: its model is large."""
    return DlibLandmarks()
