"""Landmarks of every face in photos, by any detector, in the order that the method takes."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from deepmds_keras.detection.detectors import DETECTORS, Find
from deepmds_keras.errors import InputError
from deepmds_keras.landmarks.conversion import convert
from deepmds_keras.photos import open_photo, photo_step
from deepmds_keras.predict.models import taken

_TURNS = (0, 1, 3, 2)  # quarters to the left; of what is equally good the first is taken
# MediaPipe's score is 0.90 to 0.96 for upright photos, and at most 0.88 for the same photos turned.
_SURE = 0.9


def faces_in_photos(
    photos: list[Path], detector: str, landmarker: str | None, model: str | None
) -> list[np.ndarray | InputError]:
    """Landmarks of the faces in each photo.

    A photo in which there is none for sure is turned by quarters: one without the camera's note on
    which way is up may lie on its side. dlib finds no face then, MediaPipe often a wrong one.

    Args:
        photos: Files.
        detector: One of `DETECTORS`.
        landmarker: What its `open` takes.
        model: That will take the landmarks, as `models.taken` has it.

    Returns:
        For each photo `(n, L, 2)` pixels of the photo as it is, x right and y down, of all its
        faces, from left to right, in the scheme that the model takes; or why there is none.

    Raises:
        InputError: The detector itself cannot be used.
    """
    scheme, find = DETECTORS[detector].scheme, DETECTORS[detector].open(landmarker)
    target = taken(scheme, model)

    def faces_in(path: Path) -> np.ndarray | InputError:
        try:
            faces = _whichever_side_is_up(open_photo(path), find)
        except InputError as error:
            return error
        if not len(faces):
            return no_face(path, detector, "whichever side is up")
        return convert(faces, scheme, target) * photo_step(path)

    return [faces_in(path) for path in photos]


def faces_in_photo(photo: np.ndarray, detector: str, model: str | None) -> np.ndarray:
    """`faces_in_photos` of one in memory, `(H, W, 3)` uint8 RGB; there may be none."""
    row = DETECTORS[detector]
    faces = _whichever_side_is_up(photo, _opened(row.open, None))
    return convert(faces, row.scheme, taken(row.scheme, model))


def faces_in_images(
    images: list[np.ndarray], detector: str, landmarker: str | None, model: str | None
) -> list[np.ndarray]:
    """Landmarks of the faces in each image `(H, W, 3)` uint8 RGB, as it stands.

    Returns:
        For each `(n, L, 2)` pixels, x right and y down, the largest face first; n may be 0.

    Raises:
        InputError: The detector cannot be used.
    """
    row = DETECTORS[detector]
    find, target = _opened(row.open, landmarker), taken(row.scheme, model)
    return [convert(find(image)[0], row.scheme, target) for image in images]


def no_face(source: Path, detector: str, where: str) -> InputError:
    """Return the error of a photo or video in which no face was found."""
    others = " or ".join(name for name in DETECTORS if name != detector)
    return InputError(
        f"{source}: no face found by {detector}, {where}; try --detector {others}, or give the "
        "landmarks instead."
    )


def _whichever_side_is_up(photo: np.ndarray, find: Find) -> np.ndarray:
    """Landmarks of the faces in a photo, in its own pixels, from left to right."""
    tries = []
    for n in _TURNS:
        own, score = find(np.ascontiguousarray(np.rot90(photo, n)))
        tries.append((score, len(own), own, n))
        if n == 0 and score >= _SURE:
            break
    *_, faces, n = max(tries, key=lambda one: one[:2])
    faces = _turned_back(faces, n, *photo.shape[1::-1])
    return faces[faces[..., 0].mean(1).argsort()]


def _turned_back(points: np.ndarray, quarters: int, width: int, height: int) -> np.ndarray:
    """Points of `np.rot90(photo, quarters)` in the photo, of that size."""
    x, y = points[..., 0], points[..., 1]
    back = {0: (x, y), 1: (width - y, x), 2: (width - x, height - y), 3: (y, height - x)}[quarters]
    return np.stack(back, axis=-1)


@cache
def _opened(open_: Callable[[str | None], Find], landmarker: str | None) -> Find:
    """Once in a process: a landmarker takes a while to load."""
    return open_(landmarker)
