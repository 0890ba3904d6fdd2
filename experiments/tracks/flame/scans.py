"""Stage of the FLAME track: test faces, their landmarks detected in photos and found on scans."""

from __future__ import annotations

import shutil
from itertools import chain
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

from data_gen.datasets.casia import write_index
from data_gen.datasets.dataset import Dataset
from data_gen.datasets.scans_standin import ScansStandin
from data_gen.fitting.ground_truth import GroundTruth
from data_gen.models.registry import load_model
from data_gen.views.projections import Cameras, camera_angles
from deepmds_keras.weights import read_arrays
from experiments.inputs import in_photos
from experiments.progress import Bar
from experiments.run import Run, parse_run, stage, write_bytes
from experiments.streams import Stream
from experiments.tracks.flame.examination import CasiaScans, examine, images_file, subject_file
from experiments.tracks.found_faces import save_test_set


def collect(run: Run, n_subjects: int) -> dict:
    """Join the subjects' files into the test set and its images.

    Returns:
        For the record: how many scans of which status, and the images' checksums.
    """
    parts: dict[str, list[np.ndarray]] = {}
    n_scans = 0
    for subject in range(n_subjects):
        arrays, _ = read_arrays(subject_file(run, subject))
        if "example" in arrays:
            arrays["example"] += n_scans
        n_scans += len(arrays["status"])
        for key, array in arrays.items():
            parts.setdefault(key, []).append(array)
    table = {key: np.concatenate(arrays) for key, arrays in parts.items()}
    images = chain.from_iterable(np.load(images_file(run, k)) for k in range(n_subjects))
    return save_test_set(run, "scan", table, images, lambda used: _test_set(run, table, used))


def _test_set(run: Run, table: dict[str, np.ndarray], used: np.ndarray) -> Dataset:
    """Test faces: detected landmarks for views, landmarks found on scans for the truth."""
    views = table["detected"][used] * (1, -1)
    n = len(views)
    angles = camera_angles(table["rotation"][used])
    cameras = Cameras(np.zeros(n, int), *angles, np.zeros(n))
    description = {"model": run.model, "scheme": run.scheme, "truth": "nearest scan points"}
    none = np.empty((n, 0), np.float32)
    landmarks = np.float32(table["landmarks"][used])
    return in_photos(run, Dataset(none, none, landmarks, np.float32(views), cameras, description))


def casia_scans(run: Run, folder: Path) -> CasiaScans:
    """The scans that the index names; without one, all, and an index for the user to edit."""
    source = CasiaScans(folder, run.casia_index)
    template = run.work / "casia-index.csv"
    if run.casia_index is None and not template.exists():
        write_index(template, source.found)
        print(f"  all scans are used; to choose, edit {template} and name it by CASIA_INDEX=")
    # Subjects that a stopped run has done with another choice of scans are of no use.
    chosen, scans = run.work / "scans" / "index.csv", run.work / "scans"
    content = b"" if run.casia_index is None else run.casia_index.read_bytes()
    if scans.exists() and not (chosen.exists() and chosen.read_bytes() == content):
        shutil.rmtree(scans)
    write_bytes(chosen, content)
    return source


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    with stage(run, "scans") as record:
        model = load_model(run.model, run.data, run.scheme)
        folder, preset = run.folder_of("casia"), run.preset
        if folder is None:
            record["source"] = f"stand-in, {model.name}"
            seed = [run.seed, Stream.SCANS]
            source = ScansStandin(model, preset.scan_subjects, preset.scans, seed)
        else:
            record["source"] = "CASIA-3D"
            source = casia_scans(run, folder)
        finder = GroundTruth(model)
        subjects = range(source.n_subjects)
        missing = [k for k in subjects if not subject_file(run, k).exists()]
        tasks = (delayed(examine)(run, source, finder, subject) for subject in missing)
        done = source.n_scans - sum(source.scans_of(subject) for subject in missing)
        with Bar(total=source.n_scans, initial=done, desc="scans", unit="scan") as bar:
            for n in Parallel(run.jobs, return_as="generator_unordered")(tasks):
                bar.update(n)
        record |= collect(run, source.n_subjects)
        shutil.rmtree(run.work / "scans")
        for status, n in record["scans"].items():
            print(f"  {n} {status}")
