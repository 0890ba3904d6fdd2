"""Landmarks of every face in photos, by any detector, in the order that the method takes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from deepmds_keras.detection.detectors import DETECTORS
from deepmds_keras.io.errors import InputError
from deepmds_keras.landmarks.conversion import convert
from deepmds_keras.photos import open_photo

SCHEME = "ibug51"


def faces_in_photos(
    photos: list[Path], detector: str, found: str | None
) -> list[np.ndarray | InputError]:
    """Landmarks of the faces in each photo.

    Args:
        photos: Files.
        detector: One of `DETECTORS`.
        found: What its `find` returned.

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

    row = DETECTORS[detector]
    # All are looked at now, and `unreadable` is complete.
    faces = iter([convert(own, row.scheme, SCHEME) for own in row.detect(readable(), found)])
    return [
        unreadable[path] if path in unreadable else _some(next(faces), path, detector)
        for path in photos
    ]


def _some(faces: np.ndarray, photo: Path, detector: str) -> np.ndarray | InputError:
    if len(faces):
        return faces
    others = " or ".join(name for name in DETECTORS if name != detector)
    return InputError(
        f"{photo}: no face found by {detector}; try --detector {others}, or give the landmarks "
        "instead of the photo."
    )
