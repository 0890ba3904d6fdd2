"""The detectors of landmarks in photos, a row each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from deepmds_keras.detection import mediapipe_landmarks
from deepmds_keras.detection.dlib_landmarks import shared_detector


@dataclass(frozen=True)
class Detector:
    """Landmarks of all faces in photos, by one program.

    Attributes:
        scheme: Of the landmarks.
        find: Called before the work begins with the path of the program's interpreter, or None;
            returns what `detect` needs of it. InputError says how the detector is installed.
        detect: Called with RGB photos `(H, W, 3)`, one after the other, and what `find` returned;
            gives of each photo `(n, L, 2)` pixels, x right and y down, the largest face first.
        terms: Licence of what it finds the landmarks with, for the help of the command.
    """

    scheme: str
    find: Callable[[str | None], str | None]
    detect: Callable[[Iterable[np.ndarray], str | None], Iterator[np.ndarray]]
    terms: str


def _find_dlib(_python):
    shared_detector()


def _by_dlib(photos, _found):
    return map(shared_detector().detect_all, photos)


def _find_mediapipe(python):
    return str(mediapipe_landmarks.find_python(python))


def _by_mediapipe(photos, python):
    meshes = mediapipe_landmarks.detect_all(photos, python)
    return (mesh[..., :2].astype(float) for mesh in meshes)


DETECTORS = {
    "dlib": Detector("ibug68", _find_dlib, _by_dlib, "its model not for commercial use"),
    "mediapipe": Detector("mediapipe", _find_mediapipe, _by_mediapipe, "Apache 2.0"),
}
