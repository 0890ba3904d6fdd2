"""Stage of the CelebA experiment: the face model fitted to each photo, for truth and for views.

As in the paper: what the fit finds is both the truth that methods are measured against and, seen
by the camera of the fit, the landmarks that they are given.
"""

from __future__ import annotations

import shutil

import numpy as np
from joblib import Parallel, delayed

from data_gen.datasets.dataset import Dataset
from data_gen.fitting.edge_fitting import EdgeFitter
from data_gen.models.registry import load_model
from data_gen.views.projections import Cameras, camera_angles
from deepmds_keras.weights import read_arrays
from experiments.inputs import USED
from experiments.progress import Bar
from experiments.run import Run, parse_run, stage
from experiments.tracks.celeba.photo_fits import files_of, fit_photos, numbers_of, photos_file
from experiments.tracks.celeba.photo_sources import photo_source
from experiments.tracks.found_faces import save_test_set


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


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    with stage(run, "photos") as record:
        model = load_model(run.model, run.data, run.scheme)
        source = photo_source(run)
        record |= {"model_sha256": model.sha256, "source": source.source}
        fitter = EdgeFitter(model)
        missing = [file for file in files_of(source) if not photos_file(run, file).exists()]
        tasks = (delayed(fit_photos)(run, source, model, fitter, file) for file in missing)
        left = sum(len(numbers_of(file, len(source))) for file in missing)
        with Bar(total=len(source), initial=len(source) - left, desc="photos", unit="photo") as bar:
            for n in Parallel(run.jobs, return_as="generator_unordered")(tasks):
                bar.update(n)
        record |= collect(run, source)
        shutil.rmtree(run.work / "photos")
        for status, n in record["photos"].items():
            print(f"  {n} {status}")
