"""Landmarks of every face in photos, by any detector, in the order that the method takes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from deepmds_keras.detection.detectors import DETECTORS
from deepmds_keras.io.errors import InputError
from deepmds_keras.landmarks.conversion import convert
from deepmds_keras.photos import open_photo, photo_step

SCHEME = "ibug51"
_TURNS = (1, 3, 2)  # quarters to the left; of equally many faces the first are taken


def faces_in_photos(
    photos: list[Path], detector: str, found: str | None
) -> list[np.ndarray | InputError]:
    """Landmarks of the faces in each photo.

    A photo in which there is none is turned by quarters: one without the camera's note on which
    way is up may lie on its side, and detectors know upright faces.

    Args:
        photos: Files.
        detector: One of `DETECTORS`.
        found: What its `find` returned.

    Returns:
        For each photo `(n, 51, 2)` pixels of the photo as it is, x right and y down, of all its
        faces, the largest first; or why there is none.

    Raises:
        InputError: The detector itself cannot be used.
    """
    row, unreadable, sizes = DETECTORS[detector], {}, {}

    def turned(paths: list[Path], quarters: Sequence[int]) -> Iterator[np.ndarray]:
        """One by one: a photo may take 200 MB."""
        for path in paths:
            try:
                photo = open_photo(path)
            except InputError as error:
                unreadable[path] = error
                continue
            sizes[path] = photo.shape[1::-1]
            for n in quarters:
                yield np.ascontiguousarray(np.rot90(photo, n))

    def search(paths: list[Path], quarters: Sequence[int]) -> dict[Path, tuple[np.ndarray, ...]]:
        """Faces in each photo that can be read, once for each way that it is turned."""
        images = turned(paths, quarters)
        each = iter([convert(own, row.scheme, SCHEME) for own in row.detect(images, found)])
        readable = [path for path in paths if path not in unreadable]  # now that all were read
        return dict(zip(readable, zip(*[each] * len(quarters), strict=True), strict=True))

    faces = {path: own for path, (own,) in search(photos, (0,)).items()}
    if without := [path for path, own in faces.items() if not len(own)]:
        for path, tries in search(without, _TURNS).items():
            n, own = max(zip(_TURNS, tries, strict=True), key=lambda turn: len(turn[1]))
            faces[path] = _turned_back(own, n, *sizes[path])
    return [
        unreadable[path] if path in unreadable else _some(faces[path], path, detector)
        for path in photos
    ]


def _turned_back(points: np.ndarray, quarters: int, width: int, height: int) -> np.ndarray:
    """Points of `np.rot90(photo, quarters)` in the photo, of that size."""
    x, y = points[..., 0], points[..., 1]
    back = {1: (width - y, x), 2: (width - x, height - y), 3: (y, height - x)}[quarters]
    return np.stack(back, axis=-1)


def _some(faces: np.ndarray, photo: Path, detector: str) -> np.ndarray | InputError:
    if len(faces):
        return faces * photo_step(photo)
    others = " or ".join(name for name in DETECTORS if name != detector)
    return InputError(
        f"{photo}: no face found by {detector}, whichever side is up; try --detector {others}, or "
        "give the landmarks instead of the photo."
    )
