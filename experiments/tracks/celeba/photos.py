"""Stage of the CelebA experiment: the face model fitted to each photo, for truth and for views.

As in the paper: what the fit finds is both the truth that methods are measured against and, seen
by the camera of the fit, the landmarks that they are given.
"""

from __future__ import annotations

import functools
import shutil
from pathlib import Path

import numpy as np

from data_gen.datasets.dataset import Dataset
from data_gen.fitting.edge_fitting import EdgeFitter
from data_gen.models.morphable_model import MorphableModel
from data_gen.models.registry import load_model
from data_gen.rendering.crops import crop
from data_gen.rendering.renderer import MARGIN
from data_gen.views.projections import Cameras
from deepmds_keras.camera import camera_angles
from deepmds_keras.detection.dlib_landmarks import N_LANDMARKS, shared_detector
from deepmds_keras.io.archives import read_arrays, write_arrays
from deepmds_keras.io.errors import InputError
from deepmds_keras.photos import IMAGE_SIZE
from experiments.arguments import parse_run
from experiments.inputs import USED
from experiments.progress import Bar
from experiments.run import Run
from experiments.running import stage
from experiments.tasks import unordered
from experiments.tracks.celeba.photo_sources import PhotoSample, photo_source
from experiments.tracks.found_faces import save_test_set

_PHOTOS_PER_FILE = 100


def fit_photos(run: Run, file: int) -> int:
    """Write what is found in one file's worth of photos.

    Returns:
        Number of photos.
    """
    source, model, fitter = photo_source(run), _model(run), _fitter(run)
    numbers = numbers_of(file, len(source))
    landmark_model = model.restrict(model.landmarks[run.scheme])
    rows = [fitted(photo, landmark_model, fitter) for photo in source.photos(numbers)]
    write_arrays(
        photos_file(run, file), {key: np.stack([row[key] for row in rows]) for key in rows[0]}, {}
    )
    return len(numbers)


def fitted(photo: PhotoSample, landmark_model: MorphableModel, fitter: EdgeFitter) -> dict:
    """A row of the table of photos."""
    n = landmark_model.n_vertices
    row = {
        "name": np.array(photo.name),
        "status": np.array("no face found"),
        "image": np.zeros((IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8),
        "crop_landmarks": np.full((n, 2), np.nan),
        "detected": np.full((N_LANDMARKS, 2), np.nan),
        "landmarks": np.full((n, 3), np.nan),
        "pixels": np.full((n, 2), np.nan),
        "truth": np.full((n, 3), np.nan) if photo.truth is None else photo.truth,
        "true_pixels": np.full((n, 2), np.nan) if photo.pixels is None else photo.pixels,
        "rotation": np.full((3, 3), np.nan),
        "fit_rms": np.array(np.nan),
        "edge_share": np.array(np.nan),
    }
    if isinstance(photo.image, InputError):
        return row | {"status": np.array(f"unreadable: {photo.image}")}
    detected = shared_detector().detect(photo.image)
    if detected is None:
        return row
    row["detected"] = detected
    try:
        fit = fitter.fit(detected, photo.image)
    except InputError as error:
        return row | {"status": np.array(str(error))}
    row |= {"fit_rms": np.array(fit.rms), "edge_share": np.array(fit.edge_share)}
    shape = landmark_model.shape(fit.identity)
    pixels = fit.project(shape)
    row["image"], row["crop_landmarks"] = crop(photo.image, pixels, IMAGE_SIZE, MARGIN)
    return row | {
        "status": np.array(USED),
        "landmarks": shape,
        "pixels": pixels,
        "rotation": fit.camera.rotation,
    }


def files_of(source) -> range:
    return range(-(-len(source) // _PHOTOS_PER_FILE))


def numbers_of(file: int, n: int) -> range:
    return range(file * _PHOTOS_PER_FILE, min((file + 1) * _PHOTOS_PER_FILE, n))


def photos_file(run: Run, file: int) -> Path:
    return run.work / "photos" / f"{file:04}.npz"


def collect(run: Run, source) -> dict:
    """Join the files into the test set, its images and the table of all photos.

    Returns:
        For the record: how many photos of which status, and the images' checksums.
    """
    parts = [read_arrays(photos_file(run, file))[0] for file in files_of(source)]
    table = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    images = iter(table.pop("image")[table["status"] == USED])
    return save_test_set(run, "photo", table, images, lambda used: _test_set(run, table, used))


def _test_set(run: Run, table: dict[str, np.ndarray], used: np.ndarray) -> Dataset:
    """The fitted landmarks, and how the camera of the fit sees them.

    Views are in the frame of the face model, as in training: where its origin is seen is part of
    the fit.
    """
    landmarks, rotation = table["landmarks"][used], table["rotation"][used]
    views = landmarks @ np.swapaxes(rotation[:, :2], 1, 2)
    n = len(views)
    cameras = Cameras(np.zeros(n, int), *camera_angles(rotation), np.zeros(n))
    description = {"model": run.model, "scheme": run.scheme, "truth": "fit to photos"}
    none = np.empty((n, 0), np.float32)
    return Dataset(none, none, np.float32(landmarks), np.float32(views), cameras, description)


@functools.cache
def _fitter(run: Run) -> EdgeFitter:
    return EdgeFitter(_model(run))


@functools.cache
def _model(run: Run) -> MorphableModel:
    return load_model(run.model, run.data, run.scheme)


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    photo_source.cache_clear()  # the data set may have been changed since
    with stage(run, "photos") as record:
        source = photo_source(run)
        record |= {"model_sha256": _model(run).sha256, "source": source.source}
        missing = [file for file in files_of(source) if not photos_file(run, file).exists()]
        done = len(source) - sum(len(numbers_of(file, len(source))) for file in missing)
        with Bar(total=len(source), initial=done, desc="photos", unit="photo") as bar:
            for n in unordered(run.jobs, fit_photos, ((run, file) for file in missing)):
                bar.update(n)
        record |= collect(run, source)
        shutil.rmtree(run.work / "photos")
        for status, n in record["photos"].items():
            print(f"  {n} {status}")
