"""The detectors of landmarks in photos, a row each, the preferred one first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

from deepmds_keras.detection import dlib_landmarks, mediapipe_landmarks
from deepmds_keras.detection.mediapipe_models import has_face_mesh
from deepmds_keras.errors import InputError

Find = Callable[[np.ndarray], tuple[np.ndarray, float]]


@dataclass(frozen=True)
class Detector:
    """Landmarks of all faces in photos, by one program.

    Attributes:
        scheme: Of the landmarks.
        open: Called with the file of the user's own model, or None; returns what gives of an RGB
            photo `(H, W, 3)` the landmarks `(n, L, 2)` of its faces in pixels, x right and y down,
            the largest face first; and how sure it is that the photo stands upright, 0 to 1, 0
            where there is no face. InputError says how the detector is installed.
        is_installed: Loads nothing.
        licence: Of what it finds the landmarks with.
        commercial: Whether that may be used commercially.
    """

    scheme: str
    open: Callable[[str | None], Find]
    is_installed: Callable[[], bool]
    licence: str
    commercial: bool = True


def default_detector() -> str:
    """The first that is installed, or the first of all where none is."""
    return next((name for name, row in DETECTORS.items() if row.is_installed()), [*DETECTORS][0])


def describe_detector(name: str, landmarker: str | None) -> dict[str, str]:
    """Name and licence of a detector, for the files that are written."""
    if landmarker is not None:
        return {"name": name, "landmarker": landmarker, "licence": "that of the landmarker"}
    return {"name": name, "licence": DETECTORS[name].licence}


def _open_mediapipe(landmarker: str | None) -> Find:
    found = (
        mediapipe_landmarks.shared_detector()
        if landmarker is None
        else mediapipe_landmarks.MediaPipeLandmarks(landmarker)
    )

    def find(photo: np.ndarray) -> tuple[np.ndarray, float]:
        points, score = found.detect_scored(photo)
        return points[..., :2].astype(float), score

    return find


def _open_dlib(landmarker: str | None) -> Find:
    if landmarker is not None:
        raise InputError(
            f"--landmarker {landmarker} goes with --detector mediapipe. Received --detector dlib."
        )
    found = dlib_landmarks.shared_detector()

    def find(photo: np.ndarray) -> tuple[np.ndarray, float]:
        faces = found.detect_all(photo)
        return faces, float(len(faces) > 0)  # it knows upright faces only

    return find


DETECTORS = {
    "mediapipe": Detector("mediapipe", _open_mediapipe, has_face_mesh, "Apache 2.0"),
    "dlib": Detector(
        "ibug68",
        _open_dlib,
        lambda: find_spec("dlib") is not None,
        "Boost; its landmark model, trained on iBUG 300-W, for non-commercial use only",
        commercial=False,
    ),
}
