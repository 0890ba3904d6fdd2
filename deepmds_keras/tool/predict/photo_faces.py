"""Landmarks of the faces in a photo, in the order of the model's scheme."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from threading import Lock

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.landmarks import convert
from deepmds_keras.landmarks.y_axis import quarter_turns
from deepmds_keras.tool.detection import DETECTORS, Find, describe_detector, to_ibug
from deepmds_keras.tool.predict.faces import Detections, name_faces
from deepmds_keras.tool.predict.models import target_scheme

_TURNS = (0, 1, 3, 2)  # quarter turns to the left, in order of preference
# MediaPipe's best score is above 0.85 for most upright photos. Where a photo is upside down, it
# finds upright faces that are not there, with up to 0.82. Real upright faces had 0.77 or more.
SURE, _GOOD = 0.85, 0.75
_turn = Lock()


def open_detector(detector: str, landmarker: str | None) -> Find:
    """A detector of `DETECTORS`, opened once per process; InputError says what is missing.

    Threads take turns: two at once would crash it.
    """
    with _turn:
        return _opened(DETECTORS[detector].open, landmarker)


def no_face(source: Path, detector: str, where: str) -> InputError:
    """Return the error of a photo or video in which no face was found."""
    others = " or ".join(name for name in DETECTORS if name != detector)
    return InputError(
        f"{source}: no face found by {detector}, {where}; try --detector {others}, or give the "
        "landmarks instead."
    )


def find_upright(photo: np.ndarray, find: Find, scheme: str) -> tuple[np.ndarray, np.ndarray]:
    """Faces of a photo `(H, W, 3)` uint8 RGB, which may lie on its side: see `best_turn`.

    Returns:
        `(n, L, 2)` pixels of the original photo in the detector's scheme, from left to right, and
        scores `(n,)`.
    """
    _, turn, faces, scores = best_turn(photo, find, scheme)
    faces = turn_back(faces, turn, photo)
    order = faces[..., 0].mean(1).argsort()
    return faces[order], scores[order]


def best_turn(
    photo: np.ndarray, find: Find, scheme: str
) -> tuple[float, int, np.ndarray, np.ndarray]:
    """The orientation in which a photo shows upright faces best, as it is if they are certain.

    The photo may lack the camera's orientation tag. A turn counts if it brings an upright face with
    a good score. On a photo that lies dlib finds no face, and MediaPipe one that lies or a wrong
    one.

    Returns:
        The score of the best upright face, at least `SURE` if it is certain, 0 if there is none;
        quarter turns to the left; and what `find` returns for the photo turned so.
    """
    tries = []
    for turn in _TURNS:
        faces, scores = find(np.ascontiguousarray(np.rot90(photo, turn)))
        stands = quarter_turns(faces, scheme) == 0 if len(faces) else np.empty(0, bool)
        best = np.nan_to_num(scores[stands], nan=1.0).max(initial=0)
        if turn == 0 or best >= _GOOD:
            tries.append((best, turn, faces, scores))
        if turn == 0 and best >= SURE:
            break
    return max(tries, key=lambda each: (each[0], len(each[2])))


def turn_back(faces: np.ndarray, turn: int, photo: np.ndarray) -> np.ndarray:
    """Landmarks `(n, L, 2)` that were found in `np.rot90(photo, turn)`, in the photo's pixels."""
    height, width = photo.shape[:2]
    x, y = faces[..., 0], faces[..., 1]
    back = {0: (x, y), 1: (width - y, x), 2: (width - x, height - y), 3: (y, height - x)}[turn]
    return np.stack(back, axis=-1)


def find_in_photo(
    photo: np.ndarray,
    source: Path | None,
    name: str,
    *,
    detector: str,
    landmarker: str | None = None,
    model: str | None = None,
    n_pictures: int = 1,
) -> Detections:
    """Landmarks of the faces in a photo, which may lie on its side; there may be none.

    Args:
        photo: `(H, W, 3)` uint8 RGB.
        source: Its file; None for a photo in memory.
        name: Name of its results.
        detector: One of `DETECTORS`.
        landmarker: Model file for its `open`, or None.
        model: Model that will take the landmarks, as for `target_scheme`.
        n_pictures: Number of pictures in the file, of which the photo is the first.

    Raises:
        InputError: The detector cannot be used, or there is no such model.
    """
    scheme = DETECTORS[detector].scheme
    target = target_scheme(scheme, model)
    note = f"is in the first of {n_pictures} pictures of the file; for all, convert it to MP4"
    landmarks, scores = find_upright(photo, open_detector(detector, landmarker), scheme)
    return Detections(
        source=source,
        names=name_faces(name, len(landmarks)),
        scheme=target,
        landmarks=to_ibug(convert(landmarks, scheme, target), detector, target),
        is_photo=source is not None,
        detector=describe_detector(detector, landmarker),
        scores=scores,
        notes=dict.fromkeys(range(len(landmarks)), note) if n_pictures > 1 else {},
    )


@cache
def _opened(open_, landmarker: str | None) -> Find:
    """Open a detector once per process: a landmarker takes a while to load."""
    find = open_(landmarker)

    def find_in_turn(*arguments: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        with _turn:
            return find(*arguments)

    return find_in_turn
