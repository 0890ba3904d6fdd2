"""Detectors of 2D landmarks in photos, a row each, the preferred one first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.files import read_table
from deepmds_keras.geometry.units import rms_radius
from deepmds_keras.landmarks import DETECTOR_ERRORS, convert, load_scheme
from deepmds_keras.landmarks.y_axis import eyes_to_mouth
from deepmds_keras.tool.detection import dlib_landmarks, mediapipe_landmarks

Find = Callable[..., tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Detector:
    """A program that finds the landmarks of all faces in a photo.

    Attributes:
        scheme: Scheme of its landmarks.
        open: Takes the user's model file, or None, and returns a function. From an RGB photo
            `(H, W, 3)` that gives the landmarks `(n, L, 2)` of its faces in pixels, x right and y
            down, the largest face first; and scores `(n,)`, 0 to 1, NaN if the detector has none
            and finds upright faces only. In a video it also takes the landmarks of the frame
            before, or None; it may look there first. Threads call it in turns. If the detector is
            not installed, an InputError says how to.
        is_installed: Whether it is installed; loads nothing.
        licence: Licence of its landmark model.
        commercial: Whether that allows commercial use.
    """

    scheme: str
    open: Callable[[str | None], Find]
    is_installed: Callable[[], bool]
    licence: str
    commercial: bool = True


def default_detector(landmarker: str | Path | None = None) -> str:
    """The first detector that is installed, or the first of all if none is.

    A landmarker is MediaPipe's.
    """
    if landmarker is not None:
        return "mediapipe"
    return next((name for name, row in DETECTORS.items() if row.is_installed()), [*DETECTORS][0])


def describe_detector(name: str, landmarker: str | None) -> dict[str, str]:
    """Name and licence of a detector, for the files that are written."""
    if landmarker is not None:
        return {"name": name, "landmarker": landmarker, "licence": "that of the landmarker"}
    return {"name": name, "licence": DETECTORS[name].licence}


def to_ibug(landmarks: np.ndarray, detector: str | None, scheme: str) -> np.ndarray:
    """Landmarks of a detector, moved to where the training shapes of the weights have them.

    They move by the mean offset in `landmarks/detectors.csv`, in the axes of the upright face.

    Args:
        landmarks: `(n, L, 2)` pixels, x right and y down, or NaN. Those of a face that lacks some
            do not move: its axes are not known.
        detector: One of `DETECTORS`; None if unknown: they do not move.
        scheme: Scheme of the landmarks; without a row in the table they do not move.
    """
    rows = measured(detector, scheme)
    if rows is None:
        return landmarks
    moved = move(landmarks, scheme, rows[:, :2])
    return np.where(np.isnan(moved), landmarks, moved)


def move(landmarks: np.ndarray, scheme: str, offsets: np.ndarray) -> np.ndarray:
    """Landmarks `(n, L, 2)` moved by offsets `(L, 2)` in axes and sizes of `upright_axes`."""
    axes, radius = upright_axes(landmarks, scheme)
    return landmarks + radius[:, None, None] * (offsets @ axes)


def upright_axes(landmarks: np.ndarray, scheme: str) -> tuple[np.ndarray, np.ndarray]:
    """Axes and size of each face, of landmarks `(n, L, 2)` as for `to_ibug`.

    Returns:
        `(n, 2, 2)` unit vectors, the first from the subject's right to the left, the second from
        the eyes to the mouth; `(n,)` root mean square radii of the landmarks `ibug51`.
    """
    down = eyes_to_mouth(landmarks, scheme)
    down = down / np.linalg.norm(down, axis=1, keepdims=True)
    right = np.stack([down[:, 1], -down[:, 0]], axis=1)
    return np.stack([right, down], axis=1), rms_radius(convert(landmarks, scheme, "ibug51"))


def detector_sd(detector: str | None, scheme: str) -> np.ndarray | None:
    """Standard deviation of a coordinate of each landmark that `to_ibug` returns.

    Returns:
        `(L,)` in root mean square radii of the face's landmarks `ibug51`; None where the table has
        no such landmarks.
    """
    rows = measured(detector, scheme)
    return None if rows is None else rows[:, 2]


def sd_of_landmarks(landmarks: np.ndarray, detector: str | None, scheme: str) -> np.ndarray | None:
    """`detector_sd` of each face `(n, L, 2)`, in the unit of its landmarks: `(n, L)`, or None."""
    sd = detector_sd(detector, scheme)
    if sd is None:
        return None
    known = np.where(np.isnan(landmarks), np.nanmean(landmarks, axis=1, keepdims=True), landmarks)
    return rms_radius(convert(known, scheme, "ibug51"))[:, None] * sd


@cache
def measured(detector: str | None, scheme: str) -> np.ndarray | None:
    """`(L, 3)` of the table: offsets x and y, standard deviation."""
    table = read_table(DETECTOR_ERRORS)
    rows = {
        int(row["landmark"]): [float(row[name]) for name in ("dx", "dy", "sd")]
        for row in table
        if row["detector"] == detector
    }
    numbers = load_scheme(scheme).numbers if scheme.startswith("ibug") else ()
    return np.array([rows[n] for n in numbers]) if rows.keys() >= {*numbers} != set() else None


def _open_mediapipe(landmarker: str | None) -> Find:
    if landmarker is None:
        detector = mediapipe_landmarks.shared_detector()
    else:
        detector = mediapipe_landmarks.MediaPipeLandmarks(landmarker)

    def find(photo: np.ndarray, before: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        points, scores = detector.detect_scored(photo, before)
        return points[..., :2].astype(float), scores

    return find


def _open_dlib(landmarker: str | None) -> Find:
    if landmarker is not None:
        raise InputError(
            f"--landmarker {landmarker} needs --detector mediapipe. Received --detector dlib."
        )
    detector = dlib_landmarks.shared_detector()

    def find(photo: np.ndarray, before: object = None) -> tuple[np.ndarray, np.ndarray]:
        faces = detector.detect_all(photo)
        return faces, np.full(len(faces), np.nan)

    return find


DETECTORS = {
    "mediapipe": Detector(
        "mediapipe", _open_mediapipe, mediapipe_landmarks.has_mediapipe, "Apache 2.0"
    ),
    "dlib": Detector(
        "ibug68",
        _open_dlib,
        lambda: find_spec("dlib") is not None,
        "Boost; its landmark model, trained on iBUG 300-W, for non-commercial use only",
        commercial=False,
    ),
}
# A scheme with the name of a detector is that one's alone: who has such landmarks has them from it.
FOUND_BY = {row.scheme: name for name, row in DETECTORS.items() if row.scheme == name}
