"""Detectors of 2D landmarks in photos, a row each, the preferred one first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec

import numpy as np

from deepmds_keras.detection import dlib_landmarks, mediapipe_landmarks
from deepmds_keras.errors import InputError
from deepmds_keras.files import read_table
from deepmds_keras.landmarks import FOLDER

Find = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Detector:
    """Landmarks of all faces in photos, by one program.

    Attributes:
        scheme: Of the landmarks.
        open: Called with the file of the user's model, or None; returns what gives of an RGB photo
            `(H, W, 3)` the landmarks `(n, L, 2)` of its faces in pixels, x right and y down, the
            largest face first; and their scores `(n,)`, 0 to 1, NaN where the detector has none
            and finds upright faces only. InputError says how the detector is installed.
        is_installed: Loads nothing.
        licence: Of its landmark model.
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


@cache
def detector_sd(detector: str, scheme: str) -> np.ndarray | None:
    """Root mean square error of a coordinate of each landmark, measured on synthetic photos.

    Returns:
        `(L,)` in root mean square radii of the face's landmarks `ibug51`; None where it was not
        measured.
    """
    rows = read_table(FOLDER / "detector_errors.csv")
    sd = [
        float(row["sd"]) for row in rows if (row["detector"], row["scheme"]) == (detector, scheme)
    ]
    return np.array(sd) if sd else None


def _open_mediapipe(landmarker: str | None) -> Find:
    if landmarker is None:
        detector = mediapipe_landmarks.shared_detector()
    else:
        detector = mediapipe_landmarks.MediaPipeLandmarks(landmarker)

    def find(photo: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        points, scores = detector.detect_scored(photo)
        return points[..., :2].astype(float), scores

    return find


def _open_dlib(landmarker: str | None) -> Find:
    if landmarker is not None:
        raise InputError(
            f"--landmarker {landmarker} goes with --detector mediapipe. Received --detector dlib."
        )
    detector = dlib_landmarks.shared_detector()

    def find(photo: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        faces = detector.detect_all(photo)
        return faces, np.full(len(faces), np.nan)

    return find


DETECTORS = {
    "mediapipe": Detector(
        "mediapipe", _open_mediapipe, mediapipe_landmarks.has_face_mesh, "Apache 2.0"
    ),
    "dlib": Detector(
        "ibug68",
        _open_dlib,
        lambda: find_spec("dlib") is not None,
        "Boost; its landmark model, trained on iBUG 300-W, for non-commercial use only",
        commercial=False,
    ),
}
