"""Landmarks of every face in photos, by either detector, in the order that the method takes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from deepmds_keras.detection import mediapipe_landmarks
from deepmds_keras.detection.dlib_landmarks import shared_detector
from deepmds_keras.io.errors import InputError
from deepmds_keras.landmarks.conversion import convert
from deepmds_keras.photos import open_photo

DETECTORS = ("dlib", "mediapipe")
SCHEME = "ibug51"


def find_detector(detector: str, mediapipe_python: str | None) -> str | None:
    """What `faces_in_photos` needs: the interpreter of MediaPipe's environment; dlib needs none.

    Raises:
        InputError: The detector is not installed; says how to.
    """
    if detector == "mediapipe":
        return str(mediapipe_landmarks.find_python(mediapipe_python))
    shared_detector()
    return None


def faces_in_photos(
    photos: list[Path], detector: str, mediapipe_python: str | None
) -> list[np.ndarray | InputError]:
    """What is found in each photo.

    Args:
        photos: Files.
        detector: One of `DETECTORS`.
        mediapipe_python: As from `find_detector`.

    Returns:
        For each photo `(n, 51, 2)` pixels, x right and y down, of all its faces, the largest first;
        or why there is none.

    Raises:
        InputError: The detector itself cannot be used.
    """
    unreadable: dict[Path, InputError] = {}

    def readable() -> Iterator[np.ndarray]:
        """One by one: a photo may take 200 MB."""
        for path in photos:
            try:
                yield open_photo(path)
            except InputError as error:
                unreadable[path] = error

    if detector == "dlib":
        found = _by_dlib(readable())
    else:
        found = _by_mediapipe(readable(), mediapipe_python)
    found = iter(list(found))  # all are looked at now, and `unreadable` is complete
    return [
        unreadable[path] if path in unreadable else _some(next(found), path, detector)
        for path in photos
    ]


def _some(faces: np.ndarray, photo: Path, detector: str) -> np.ndarray | InputError:
    if len(faces):
        return faces
    (other,) = set(DETECTORS) - {detector}
    return InputError(
        f"{photo}: no face found by {detector}; try --detector {other}, or give the landmarks "
        "instead of the photo."
    )


def _by_dlib(photos: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
    return (convert(shared_detector().detect_all(photo), "ibug68", SCHEME) for photo in photos)


def _by_mediapipe(photos: Iterable[np.ndarray], python: str) -> Iterator[np.ndarray]:
    meshes = mediapipe_landmarks.detect_all(photos, python)
    return (convert(mesh[..., :2].astype(float), "mediapipe", SCHEME) for mesh in meshes)
