"""FaceMesh's 468 points of faces in images, by the virtual environment that has MediaPipe.

MediaPipe 0.10.21 brings its FaceMesh model with it, which the newest releases do not, but cannot
share an environment with TensorFlow (numpy below 2, protobuf below 5). FaceMesh: Kartynnik et al.
2019, arXiv:1907.06724.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path

import numpy as np

from data_gen.errors import DataError
from data_gen.mediapipe_worker import N_POINTS, UNREADABLE_INPUT
from data_gen.tables import read_table

MEDIAPIPE_PYTHON = Path(".venv-mediapipe/bin/python")  # `make setup-mediapipe` puts it there
CHOICES = ("corrected", "authors")
_WORKER = Path(__file__).with_name("mediapipe_worker.py")
_TABLE = Path(__file__).parent / "landmarks" / "mediapipe51.csv"
_LINES_OF_TAIL = 12


def detect(
    inputs: Iterable[str | Path],
    python: str | Path = MEDIAPIPE_PYTHON,
    progress: Callable[[int], object] | None = None,
) -> np.ndarray:
    """Points of the most prominent face in each image, each image by itself.

    Args:
        inputs: Image stacks (`.npy`, uint8 `(n, H, W, 3)` RGB) and image files (one image each, as
            stored).
        python: Interpreter of the environment with MediaPipe.
        progress: Called with the number of images just done.

    Returns:
        `(n, 468, 3)` float32, all images of all inputs in order; pixels, x right and y down from
        the left upper corner, z of the same scale and growing towards the viewer. NaN where no
        face is found.

    Raises:
        DataError: An input is no such file, or MediaPipe is missing or fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        inputs_list, output = Path(folder) / "inputs.json", Path(folder) / "points.npz"
        inputs_list.write_text(json.dumps([str(path) for path in inputs]), encoding="utf-8")
        _run([str(python), "-I", str(_WORKER), str(inputs_list), str(output)], progress)
        with np.load(output, allow_pickle=False) as file:
            return file["landmarks"]


def landmarks51(points: np.ndarray, which: str = "corrected") -> np.ndarray:
    """The iBUG landmarks 18 to 68 among FaceMesh's points, in a right-handed frame.

    Args:
        points: `(n, 468, 3)` as from `detect`.
        which: `"corrected"`, or `"authors"`: their published list, whose left brow is off by one.

    Returns:
        `(n, 51, 3)` pixels: x right, y up (from the upper edge, so negative inside the image),
        z towards the viewer.

    Raises:
        DataError: Unknown choice, or points of another shape.
    """
    if which not in CHOICES:
        raise DataError(f"which must be one of {', '.join(CHOICES)}. Received {which!r}.")
    if points.ndim != 3 or points.shape[1:] != (N_POINTS, 3):
        raise DataError(f"points must have shape (n, {N_POINTS}, 3). Received {points.shape}.")
    return points[:, _table()[which]] * np.array((1, -1, 1), points.dtype)


@cache
def _table() -> dict[str, np.ndarray]:
    """Choice to `(51,)` 0-based numbers of FaceMesh's points."""
    rows = read_table(_TABLE)[1]
    return {which: np.array([int(row[which]) for row in rows]) for which in CHOICES}


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
            raise DataError(line.strip())
        stderr.seek(0)
        said = stderr.read().decode(errors="replace").strip().splitlines()
    tail = "\n".join(said[-_LINES_OF_TAIL:])
    raise _no_mediapipe(command[0], f"exit status {worker.returncode}, which ended in:\n{tail}")


def _no_mediapipe(python: str, received: str) -> DataError:
    return DataError(
        f"{python} must be a Python that runs MediaPipe 0.10.21; make setup-mediapipe sets it up. "
        f"Received {received}"
    )
