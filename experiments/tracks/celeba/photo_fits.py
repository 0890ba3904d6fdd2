"""What is found in one test photo after the other: landmarks, and the face model that fits them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from data_gen.fitting.edge_fitting import EdgeFitter
from data_gen.models.morphable_model import MorphableModel
from data_gen.rendering.crops import crop
from data_gen.rendering.renderer import MARGIN
from deepmds_keras.detection.dlib_landmarks import shared_detector
from deepmds_keras.io.errors import InputError
from deepmds_keras.photos import IMAGE_SIZE
from deepmds_keras.weights import write_arrays
from experiments.inputs import USED
from experiments.run import Run, one_core
from experiments.tracks.celeba.photo_sources import TestPhoto

_PHOTOS_PER_FILE = 100


def fit_photos(run: Run, source, model: MorphableModel, fitter: EdgeFitter, file: int) -> int:
    """Write what was found in one file's worth of photos.

    Returns:
        Number of photos.
    """
    numbers = numbers_of(file, len(source))
    landmark_model = model.restrict(model.landmarks[run.scheme])
    with one_core():
        rows = [fitted(photo, landmark_model, fitter) for photo in source.photos(numbers)]
    write_arrays(
        photos_file(run, file), {key: np.stack([row[key] for row in rows]) for key in rows[0]}, {}
    )
    return len(numbers)


def fitted(photo: TestPhoto, landmark_model: MorphableModel, fitter: EdgeFitter) -> dict:
    """A row of the table of photos."""
    n = landmark_model.n_vertices
    row = {
        "name": np.array(photo.name),
        "status": np.array("no face found"),
        "image": np.zeros((IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8),
        "crop_landmarks": np.full((n, 2), np.nan),
        "detected": np.full((68, 2), np.nan),
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
        "rotation": fit.rotation,
    }


def files_of(source) -> range:
    return range(-(-len(source) // _PHOTOS_PER_FILE))


def numbers_of(file: int, n: int) -> range:
    return range(file * _PHOTOS_PER_FILE, min((file + 1) * _PHOTOS_PER_FILE, n))


def photos_file(run: Run, file: int) -> Path:
    return run.work / "photos" / f"{file:04}.npz"
