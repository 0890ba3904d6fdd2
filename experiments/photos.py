"""Stage of the CelebA experiment: the face model fitted to each photo, for truth and for views.

As in the paper: what the fit finds is both the truth that methods are measured against and, seen
by the camera of the fit, the landmarks that they are given.
"""

from __future__ import annotations

import shutil
from collections import Counter

import numpy as np
from joblib import Parallel, delayed
from tqdm import tqdm

from data_gen.dataset import Dataset, save_dataset
from data_gen.edge_fitting import EdgeFitter
from data_gen.errors import DataError
from data_gen.models import load_model
from data_gen.projections import Cameras, camera_angles
from deepmds_keras.weights import read_arrays, write_arrays
from experiments.inputs import USED, crop_files
from experiments.photo_fits import files_of, fit_photos, numbers_of, photos_file
from experiments.photo_sources import photo_source
from experiments.run import Run, parse_run, stage


def collect(run: Run, source) -> dict:
    """Join the files into the test set, its images and the table of all photos.

    Returns:
        For the record: how many photos of which status, and the images' checksums.
    """
    parts = [read_arrays(photos_file(run, file))[0] for file in files_of(source)]
    table = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    used = table["status"] == USED
    if not used.any():
        raise DataError(
            f"At least one photo must give a test face. Received {len(used)}, of which: "
            + "; ".join(f"{n} {status}" for status, n in counted(table["status"]).items())
        )
    images = table.pop("image")[used]
    files = crop_files(run, int(used.sum()))
    for file, faces in enumerate(files.ranges()):
        rows = slice(faces.start, faces.stop)
        files.save(file, images[rows], np.float32(table["crop_landmarks"][used][rows]))
    # What methods made of another test set is of no use.
    shutil.rmtree(run.work / "predictions", ignore_errors=True)
    save_dataset(run.work / "test.npz", _test_set(run, table, used))
    write_arrays(run.work / "photos.npz", table, {})
    return {"photos": counted(table["status"]), "checksums": {"test": files.checksums()}}


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


def counted(status: np.ndarray) -> dict[str, int]:
    """Photos by status, the details of each left out."""
    return dict(Counter(str(reason).split(". ")[0].split(": ")[0] for reason in status))


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
        with tqdm(
            total=len(source), initial=len(source) - left, desc="photos", unit="photo"
        ) as bar:
            for n in Parallel(run.jobs, return_as="generator_unordered")(tasks):
                bar.update(n)
        record |= collect(run, source)
        shutil.rmtree(run.work / "photos")
        for status, n in record["photos"].items():
            print(f"  {n} {status}")


if __name__ == "__main__":
    main()
