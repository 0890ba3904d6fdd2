"""Photos drawn in place of CelebA's, of heads turned by up to 45 degrees."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from data_gen.datasets.portraits import Portraits
from data_gen.models.registry import load_model
from deepmds_keras.detection.dlib_landmarks import shared_detector
from deepmds_keras.io.errors import InputError
from deepmds_keras.landmarks.conversion import convert
from experiments.run import Run
from experiments.streams import Stream

_YAWS = (0, 15, 30, 45)  # degrees; of the photos drawn the nearest are shown
_DRAWN = 60


def stand_in_photos(run: Run) -> tuple[list[np.ndarray], np.ndarray]:
    """Photos and the 51 landmarks that dlib finds in them, `(n, 51, 2)` pixels, y down.

    Raises:
        InputError: The face model cannot be drawn, or dlib finds too few faces.
    """
    # VTK and TensorFlow do not get on in one process.
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
        return process.submit(_chosen, run).result()


def _chosen(run: Run) -> tuple[list[np.ndarray], np.ndarray]:
    model = load_model(run.model, run.data)
    found = []
    for photo in Portraits(model, (run.seed, Stream.STAND_IN_PHOTOS)).photos(range(_DRAWN)):
        landmarks = shared_detector().detect(photo.image)
        if landmarks is not None:
            found.append((abs(photo.yaw), photo.image, convert(landmarks, "ibug68", "ibug51")))
    chosen = []
    for yaw in _YAWS:
        if not found:
            raise InputError(
                f"dlib must find {len(_YAWS)} faces in {_DRAWN} photos drawn of {run.model}. "
                f"It found {len(chosen)}."
            )
        nearest = min(range(len(found)), key=lambda k: abs(found[k][0] - yaw))
        chosen.append(found.pop(nearest))
    _, images, landmarks = zip(*chosen, strict=True)
    return [*images], np.stack(landmarks)
