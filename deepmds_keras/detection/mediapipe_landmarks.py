"""FaceMesh's 468 points of faces in images, by the virtual environment that has MediaPipe.

MediaPipe 0.10.21 brings its FaceMesh model with it, which the newest releases do not, but cannot
share an environment with TensorFlow (numpy below 2, protobuf below 5). FaceMesh: Kartynnik et al.
2019, arXiv:1907.06724.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path

import numpy as np

from deepmds_keras.detection.mediapipe_worker import N_POINTS, UNREADABLE_INPUT
from deepmds_keras.io.errors import InputError
from deepmds_keras.io.tables import read_table
from deepmds_keras.landmarks import FOLDER
from deepmds_keras.photos import check_photo

MEDIAPIPE_PYTHON = Path(".venv-mediapipe/bin/python")  # `make setup-mediapipe` puts it there
VARIABLE = "DEEPMDS_MEDIAPIPE_PYTHON"
CHOICES = ("corrected", "authors")
_WORKER = Path(__file__).with_name("mediapipe_worker.py")
_LINES_OF_TAIL = 12
_HOW_TO = (
    "make setup-mediapipe sets it up in a checkout, and elsewhere, with Python 3.10 to 3.12, "
    "python3.11 -m venv .venv-mediapipe && .venv-mediapipe/bin/pip install mediapipe==0.10.21; "
    f"one that lies elsewhere is named by {VARIABLE}"
)


def find_python(path: str | Path | None = None) -> Path:
    """The interpreter of the environment that has MediaPipe.

    Args:
        path: The interpreter itself; None takes what the variable DEEPMDS_MEDIAPIPE_PYTHON of the
            process's environment names, and where it is not set `.venv-mediapipe/bin/python` in
            the working directory.

    Raises:
        InputError: It is no file that can be run; says how to make one.
    """
    # Never resolved: the link itself is what tells Python of its virtual environment.
    python = Path(path or os.environ.get(VARIABLE) or MEDIAPIPE_PYTHON)
    if not (python.is_file() and os.access(python, os.X_OK)):
        raise _no_mediapipe(python, "a path that is no program")
    return python


def detect(
    inputs: Iterable[str | Path],
    python: str | Path = MEDIAPIPE_PYTHON,
    progress: Callable[[int], object] | None = None,
) -> np.ndarray:
    """Points of the most prominent face in each image, each image by itself.

    Args:
        inputs: As for `detect_all`.
        python: Interpreter of the environment with MediaPipe.
        progress: Called with the number of images just done.

    Returns:
        `(n, 468, 3)` float32, all images of all inputs in order; pixels, x right and y down from
        the left upper corner, z of the same scale and growing towards the viewer. NaN where no
        face is found.

    Raises:
        InputError: As `detect_all`.
    """
    landmarks, counts = _detect(inputs, python, 1, progress)
    points = np.full((len(counts), N_POINTS, 3), np.nan, np.float32)
    points[counts == 1] = landmarks
    return points


def detect_all(
    inputs: Iterable[str | Path | np.ndarray],
    python: str | Path = MEDIAPIPE_PYTHON,
    *,
    max_faces: int = 20,
    progress: Callable[[int], object] | None = None,
) -> list[np.ndarray]:
    """Points of every face in each image, each image by itself, the largest face first.

    Args:
        inputs: Image files (one image each, as stored: not turned by EXIF), image stacks (`.npy`,
            uint8 `(n, H, W, 3)` RGB) and images `(H, W, 3)` uint8 RGB.
        python: Interpreter of the environment with MediaPipe.
        max_faces: Of one image, at least 1.
        progress: Called with the number of images just done.

    Returns:
        For each image of all inputs in order `(n, 468, 3)` float32 as in `detect`; n may be 0.

    Raises:
        InputError: An input is no such file or image, max_faces is below 1, or MediaPipe is missing
            or fails.
    """
    if max_faces < 1:
        raise InputError(f"max_faces must be at least 1. Received {max_faces}.")
    landmarks, counts = _detect(inputs, python, max_faces, progress)
    areas = np.ptp(landmarks[..., :2], axis=1).prod(1)
    landmarks = landmarks[np.lexsort((-areas, np.repeat(np.arange(len(counts)), counts)))]
    return np.split(landmarks, np.cumsum(counts))[:-1]


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


def _detect(
    inputs: Iterable[str | Path | np.ndarray],
    python: str | Path,
    max_faces: int,
    progress: Callable[[int], object] | None,
) -> tuple[np.ndarray, np.ndarray]:
    """`(m, 468, 3)` points of all faces, and `(n,)` how many of them each image has."""
    with tempfile.TemporaryDirectory() as folder:
        request, output = Path(folder) / "request.json", Path(folder) / "points.npz"
        paths = []
        for each in inputs:
            if isinstance(each, np.ndarray):
                image, each = check_photo(each), Path(folder) / f"{len(paths)}.npy"
                np.save(each, image[None])
            paths.append(str(each))
        request.write_text(json.dumps({"inputs": paths, "max_faces": max_faces}), encoding="utf-8")
        _run([str(python), "-I", str(_WORKER), str(request), str(output)], progress)
        with np.load(output, allow_pickle=False) as file:
            return file["landmarks"], file["counts"]


def _run(command: list[str], progress: Callable[[int], object] | None) -> None:
    with tempfile.TemporaryFile() as stderr:
        try:
            worker = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, text=True)
        except OSError as error:
            raise _no_mediapipe(command[0], error.strerror) from None
        line = ""
        with worker:
            try:
                for line in worker.stdout:
                    # What its libraries may print is no number.
                    if progress is not None and line.strip().isdigit():
                        progress(int(line))
            except BaseException:
                worker.kill()
                raise
        if worker.returncode == 0:
            return
        if worker.returncode == UNREADABLE_INPUT and line:
            raise InputError(line.strip())
        stderr.seek(0)
        said = stderr.read().decode(errors="replace").strip().splitlines()
    if any(line.startswith("Traceback") for line in said):
        raise _no_mediapipe(command[0], said[-1])
    tail = "\n".join(said[-_LINES_OF_TAIL:])
    raise _no_mediapipe(command[0], f"exit status {worker.returncode}, which ended in:\n{tail}")


def _no_mediapipe(python: str | Path, received: str) -> InputError:
    return InputError(
        f"{python} must be a Python that runs MediaPipe 0.10.21; {_HOW_TO}. Received: {received}"
    )
