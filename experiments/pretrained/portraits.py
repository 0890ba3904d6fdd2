"""Stage before the shipped weights: photos of both open models, and what detectors find in them.

Photos of other people than those that the methods are tested on show the errors of the detectors.
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np

from data_gen.datasets.portraits import Portraits
from data_gen.models.morphable_model import MorphableModel
from data_gen.models.registry import OPEN, load_model, open_models
from deepmds_keras.detection.detectors import DETECTORS
from deepmds_keras.detection.mediapipe_landmarks import landmarks51, shared_detector
from deepmds_keras.io.archives import read_arrays, write_arrays
from deepmds_keras.io.errors import InputError
from experiments.arguments import parse_run
from experiments.progress import Bar
from experiments.run import Run
from experiments.running import stage
from experiments.streams import Stream
from experiments.tasks import unordered

SETS = ("errors", "tests")
_PER_FILE = 50


@functools.cache
def open_model(run: Run, name: str, scheme: str = "ibug68") -> MorphableModel:
    return load_model(name, run.data, scheme)


def portraits_file(run: Run, model: str, which: str, part: int | None = None) -> Path:
    """What is known of the photos of a model and set: of all, or of one task."""
    suffix = "" if part is None else f"-{part:04}"
    return run.work / "portraits" / f"{model}-{which}{suffix}.npz"


def draw(run: Run, model: str, which: str, part: int, detectors: tuple[str, ...]) -> int:
    """Write what is known of, and found in, one task's photos.

    Returns:
        Number of photos.
    """
    numbers = _parts(run, which)[part]
    seed = [run.seed, Stream.PORTRAITS, OPEN.index(model), SETS.index(which)]
    photos = [*_source(run, model, tuple(seed)).photos(numbers)]
    arrays = {"yaw": np.array([p.yaw for p in photos]), "roll": np.array([p.roll for p in photos])}
    for scheme in photos[0].landmarks:
        arrays[f"landmarks_{scheme}"] = np.stack([p.landmarks[scheme] for p in photos])
        arrays[f"pixels_{scheme}"] = np.stack([p.pixels[scheme] for p in photos])
    images = [photo.image for photo in photos]
    for detector in detectors:
        arrays |= _DETECT[detector](images)
    write_arrays(portraits_file(run, model, which, part), arrays, {})
    return len(photos)


def read_portraits(run: Run, model: str, which: str) -> dict[str, np.ndarray]:
    """Of all photos of a model and set.

    Returns:
        `yaw`, `roll` `(n,)`; `landmarks_…` and `pixels_…` of the schemes, as `Portrait` has them;
        `dlib` `(n, 68, 2)` and `mediapipe` `(n, 51, 2)` pixels, NaN where no face was found, and
        `mediapipe_shape` `(n, 51, 3)`, y up, as far as the detectors were there.
    """
    return read_arrays(portraits_file(run, model, which))[0]


def _parts(run: Run, which: str) -> list[range]:
    n = run.preset.error_portraits if which == "errors" else run.preset.test_portraits
    return [range(i, min(i + _PER_FILE, n)) for i in range(0, n, _PER_FILE)]


@functools.cache
def _source(run: Run, model: str, seed: tuple[int, ...]) -> Portraits:
    return Portraits(open_model(run, model), seed)


def _by_dlib(images: list[np.ndarray]) -> dict[str, np.ndarray]:
    find = DETECTORS["dlib"].open(None)
    return {"dlib": _largest((find(image)[0] for image in images), (68, 2))}


def _by_mediapipe(images: list[np.ndarray]) -> dict[str, np.ndarray]:
    points = _largest(map(shared_detector().detect_all, images), (468, 3))
    shapes = landmarks51(points)
    return {"mediapipe": shapes[..., :2] * (1, -1), "mediapipe_shape": shapes}


_DETECT = {"dlib": _by_dlib, "mediapipe": _by_mediapipe}


def _largest(found, shape: tuple[int, int]) -> np.ndarray:
    return np.stack([faces[0] if len(faces) else np.full(shape, np.nan) for faces in found])


def _installed(run: Run) -> tuple[list[str], dict[str, str]]:
    """The detectors that are there, and why others are not."""
    there, lacking = [], {}
    for name in _DETECT:
        if name.upper() in run.without:
            lacking[name] = f"left out ({name.upper()}=no)"
            continue
        try:
            DETECTORS[name].open(None)
        except InputError as error:
            lacking[name] = str(error)
        else:
            there.append(name)
    return there, lacking


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    with stage(run, "portraits") as record:
        models, left_out = open_models(run.data)
        detectors, lacking = _installed(run)
        hashes = {name: open_model(run, name).sha256 for name in models}
        record |= {"models": models, "left_out": left_out}
        record |= {"model_sha256": hashes[OPEN[0]], "models_sha256": hashes}
        record |= {"detectors": detectors, "lacking": lacking}
        tasks = [
            (run, model, which, part, tuple(detectors))
            for model in models
            for which in SETS
            if not portraits_file(run, model, which).exists()
            for part in range(len(_parts(run, which)))
        ]
        todo = [task for task in tasks if not portraits_file(*task[:4]).exists()]
        total = sum(len(_parts(run, which)[part]) for _, _, which, part, _ in tasks)
        left = sum(len(_parts(run, which)[part]) for _, _, which, part, _ in todo)
        with Bar(total=total, initial=total - left, desc="portraits", unit="photo") as bar:
            for n in unordered(run.jobs, draw, todo):
                bar.update(n)
        record["found"] = {}
        for model in models:
            for which in SETS:
                _join(run, model, which)
                read = read_portraits(run, model, which)
                record["found"][f"{model}-{which}"] = {
                    name: int(np.isfinite(read[name]).all((1, 2)).sum()) for name in detectors
                }


def _join(run: Run, model: str, which: str) -> None:
    if portraits_file(run, model, which).exists():
        return
    files = [portraits_file(run, model, which, part) for part in range(len(_parts(run, which)))]
    parts = [read_arrays(file)[0] for file in files]
    joined = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    write_arrays(portraits_file(run, model, which), joined, {})
    for file in files:
        file.unlink()
