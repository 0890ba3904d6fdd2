"""FaceMesh's 468 points of faces in images, by MediaPipe, and the 51 landmarks of them."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import nullcontext
from functools import cache
from pathlib import Path
from threading import Lock

import numpy as np

from deepmds_keras.detection.mediapipe_loading import silenced
from deepmds_keras.detection.mediapipe_models import N_POINTS, FaceLandmarker, FaceMesh
from deepmds_keras.errors import InputError
from deepmds_keras.files import read_table
from deepmds_keras.landmarks import FOLDER
from deepmds_keras.photos import check_photo

CHOICES = ("corrected", "authors")


@cache
def shared_detector() -> MediaPipeLandmarks:
    """One by FaceMesh for each process: it takes a while to start.

    Raises:
        InputError: As `MediaPipeLandmarks`.
    """
    return MediaPipeLandmarks()


class MediaPipeLandmarks:
    """Finds the points of the faces in an image; threads take turns.

    Args:
        landmarker: File of a face landmarker (`.task`), for a MediaPipe later than 0.10.21; None
            takes the FaceMesh that 0.10.21 brings.
        max_faces: Of one image, at least 1.

    Raises:
        InputError: No such MediaPipe is installed, the file is no such model, or max_faces is
            below 1.
    """

    def __init__(self, landmarker: str | Path | None = None, *, max_faces: int = 20):
        if max_faces < 1:
            raise InputError(f"max_faces must be at least 1. Received {max_faces}.")
        with silenced():
            self._find = (
                FaceMesh(max_faces) if landmarker is None else FaceLandmarker(landmarker, max_faces)
            )
        self._lock, self._has_found = Lock(), False

    def detect_all(self, image: np.ndarray) -> np.ndarray:
        """Points of every face, the first of what `detect_scored` gives."""
        return self.detect_scored(image)[0]

    def detect_scored(self, image: np.ndarray) -> tuple[np.ndarray, float]:
        """Points of every face, the largest first, and how sure the surest of them is.

        Args:
            image: `(H, W, 3)` uint8 RGB.

        Returns:
            `(n, 468, 3)` float32 pixels, x right and y down from the left upper corner, z of the
            same scale and growing towards the viewer; n may be 0. 0 to 1, as of `FaceMesh`.

        Raises:
            InputError: Not such an image.
        """
        image = np.ascontiguousarray(check_photo(image))
        # What the library logs it logs until it has found a face.
        with self._lock, nullcontext() if self._has_found else silenced():
            faces, score = self._find(image)
        self._has_found |= len(faces) > 0
        height, width = image.shape[:2]
        points = np.float32(faces * (width, height, -width))
        areas = np.ptp(points[..., :2], axis=1).prod(1)
        return points[np.argsort(-areas, kind="stable")], score


def detect(images: Iterable[np.ndarray]) -> np.ndarray:
    """Points of the most prominent face in each image, by FaceMesh.

    Args:
        images: `(H, W, 3)` uint8 RGB, one after the other.

    Returns:
        `(n, 468, 3)` float32 as from `MediaPipeLandmarks.detect_all`; NaN where no face is found.

    Raises:
        InputError: As `MediaPipeLandmarks`, and its `detect_all`.
    """
    detector = MediaPipeLandmarks(max_faces=1)
    none = np.full((1, N_POINTS, 3), np.nan, np.float32)
    found = [np.concatenate([detector.detect_all(image), none])[:1] for image in images]
    return np.concatenate([none[:0], *found])


def landmarks51(points: np.ndarray, which: str = "corrected") -> np.ndarray:
    """The iBUG landmarks 18 to 68 among FaceMesh's points, in a right-handed frame.

    Args:
        points: `(n, 468, 3)` as from `detect`.
        which: `"corrected"`, or `"authors"`: their published list, whose left brow is off by one.

    Returns:
        `(n, 51, 3)` pixels: x right, y up (from the upper edge, so negative inside the image),
        z towards the viewer.

    Raises:
        InputError: Unknown choice, or points of another shape.
    """
    if which not in CHOICES:
        raise InputError(f"which must be one of {', '.join(CHOICES)}. Received {which!r}.")
    if points.ndim != 3 or points.shape[1:] != (N_POINTS, 3):
        raise InputError(f"points must have shape (n, {N_POINTS}, 3). Received {points.shape}.")
    return points[:, _table()[which]] * np.array((1, -1, 1), points.dtype)


@cache
def _table() -> dict[str, np.ndarray]:
    """Choice to `(51,)` 0-based numbers of FaceMesh's points."""
    rows = read_table(FOLDER / "mediapipe_ibug68.csv")
    return {
        which: np.array([int(row[column]) for row in rows])
        for which, column in zip(CHOICES, ("number", "authors"), strict=True)
    }
