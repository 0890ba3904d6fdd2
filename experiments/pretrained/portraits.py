"""Step: renders photos of both open models, with known truth, and detects the faces in them."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from data_gen.models.registry import OPEN, TITLES, load_model, open_models
from deepmds_keras.errors import InputError
from deepmds_keras.files import read_arrays, write_arrays
from deepmds_keras.tool.detection import DETECTORS
from deepmds_keras.tool.detection.mediapipe_landmarks import landmarks51, shared_detector
from experiments.progress import Progress
from experiments.run import Run
from experiments.streams import Stream
from experiments.tasks import unordered

if TYPE_CHECKING:
    from data_gen.datasets.photos_substitute import Portraits

_PER_TASK = 50


def main(run: Run) -> dict:
    models, left_out = open_models(run.data)
    detectors = [name for name, detector in DETECTORS.items() if detector.is_installed()]
    if not detectors:
        raise InputError(f"One of {', '.join(DETECTORS)} must be installed. Received none.")
    n = run.preset.test_portraits + run.preset.further_portraits
    numbers = [range(i, min(i + _PER_TASK, n)) for i in range(0, n, _PER_TASK)]
    for model in models:
        tasks = [(run, model, each, detectors) for each in numbers]
        parts = {}
        with Progress(f"{TITLES[model]}: photo", n) as progress:
            for each, part in unordered(run.jobs, _draw, tasks):
                parts[each] = part
                progress.update(len(each))
        names = parts[numbers[0]]
        arrays = {name: np.concatenate([parts[each][name] for each in numbers]) for name in names}
        write_arrays(portraits_file(run, model), arrays, {})
    return {"detectors": detectors, "left_out": left_out}


def read_portraits(run: Run, model: str, further: bool = False) -> dict[str, np.ndarray]:
    """Truth and detections of the photos of a model on which methods are tested, or of the others.

    Returns:
        `yaw` `(n,)` degrees; `landmarks_…` and `pixels_…` of the schemes, as `Photo` has them;
        `dlib` `(n, 68, 2)` and `mediapipe` `(n, 51, 2)` pixels, NaN where no face was found, and
        `mediapipe_shape` `(n, 51, 3)`, y up, if the detectors are installed.
    """
    n = run.preset.test_portraits
    part = slice(n, None) if further else slice(n)
    return {name: of[part] for name, of in read_arrays(portraits_file(run, model))[0].items()}


def portraits_file(run: Run, model: str) -> Path:
    return run.work / "portraits" / f"{model}.npz"


def _draw(run: Run, model: str, numbers: range, detectors: list[str]) -> tuple[range, dict]:
    """Truth and detections of some photos, by their numbers: arrays by name."""
    photos = [*_source(run, model).photos(numbers)]
    arrays = {"yaw": np.array([photo.yaw for photo in photos])}
    for scheme in photos[0].landmarks:
        arrays[f"landmarks_{scheme}"] = np.stack([photo.landmarks[scheme] for photo in photos])
        arrays[f"pixels_{scheme}"] = np.stack([photo.pixels[scheme] for photo in photos])
    images = [photo.image for photo in photos]
    if "dlib" in detectors:
        find = DETECTORS["dlib"].open(None)
        arrays["dlib"] = _largest((find(image)[0] for image in images), (68, 2))
    if "mediapipe" in detectors:
        shapes = landmarks51(_largest(map(shared_detector().detect_all, images), (468, 3)))
        arrays |= {"mediapipe": shapes[..., :2] * (1, -1), "mediapipe_shape": shapes}
    return numbers, arrays


@functools.cache
def _source(run: Run, model: str) -> Portraits:
    from data_gen.datasets.photos_substitute import Portraits

    seed = (run.seed, Stream.PORTRAITS, OPEN.index(model), 1)  # 0 was of photos for training
    return Portraits(load_model(model, run.data, "ibug68"), seed)


def _largest(faces: Iterable[np.ndarray], shape: tuple[int, int]) -> np.ndarray:
    """The first face of each photo, NaN where there is none."""
    return np.stack([each[0] if len(each) else np.full(shape, np.nan) for each in faces])
