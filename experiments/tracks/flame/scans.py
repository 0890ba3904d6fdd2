"""Stage of the FLAME track: test faces, their landmarks detected in photos and found on scans."""

from __future__ import annotations

import functools
import shutil
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np

from data_gen.datasets import casia
from data_gen.datasets.dataset import Dataset
from data_gen.datasets.scans import Scan
from data_gen.datasets.scans_standin import ScansStandin
from data_gen.fitting.ground_truth import GroundTruth, Registration
from data_gen.models.morphable_model import MorphableModel
from data_gen.models.registry import load_model
from data_gen.rendering.crops import crop
from data_gen.views.projections import Cameras
from deepmds_keras.camera import camera_angles
from deepmds_keras.detection.dlib_landmarks import shared_detector
from deepmds_keras.io.archives import read_arrays, write_arrays
from deepmds_keras.io.atomic import atomic_write, write_bytes
from deepmds_keras.io.errors import InputError
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.landmarks.conversion import convert
from experiments.arguments import parse_run
from experiments.inputs import CROP_MARGIN, CROP_SIZE, USED, in_photos
from experiments.progress import Bar
from experiments.run import Run
from experiments.running import stage
from experiments.streams import Stream
from experiments.tasks import unordered
from experiments.tracks.found_faces import save_test_set

_FOUND, _KEPT = "ibug68", "ibug51"  # the paper leaves the detector's jaw line out
_EXAMPLES, _EXAMPLE_POINTS = 3, 8000  # scans kept for pictures


class CasiaScans:
    """The scans of CASIA-3D, or those that an index names, by subject.

    Args:
        folder: Of the data set.
        index: CSV that says which scans are used, or None for all.
    """

    def __init__(self, folder: Path, index: Path | None):
        self.found = casia.find_scans(folder)
        self._scans = self.found if index is None else casia.read_index(index, self.found)
        self._subjects = sorted({scan.subject for scan in self._scans})
        self.n_subjects, self.n_scans = len(self._subjects), len(self._scans)

    def scans_of(self, subject: int) -> int:
        return sum(scan.subject == self._subjects[subject] for scan in self._scans)

    def subject(self, subject: int) -> Iterator[Scan | tuple[str, str]]:
        """Scans of one subject; for one that cannot be read its name and the reason."""
        for scan in self._scans:
            if scan.subject != self._subjects[subject]:
                continue
            name = f"{scan.subject}-{scan.scan:03}"
            try:
                image, points = casia.load_scan(scan)
            except InputError as error:
                yield name, f"unreadable: {error}"
            else:
                yield Scan(name, scan.condition, image, points)


def register_scans(run: Run, subject: int) -> int:
    """Write what is found in each scan of one subject.

    Returns:
        Number of scans.
    """
    rows, example = [], {}
    for scan in scan_source(run).subject(subject):
        if isinstance(scan, tuple):
            rows.append(_refused(*scan))
            continue
        row, found = _registered(scan, _finder(run))
        if found is not None and subject < _EXAMPLES and not example:
            points = _some_points(scan, found)
            example = {"example": np.array([len(rows)]), "example_points": points[None]}
        rows.append(row)
    used = np.array([row["status"] == USED for row in rows])
    images = [row.pop("image") for row in rows]
    arrays = {key: np.stack([row[key] for row in rows]) for key in rows[0]} | example
    with atomic_write(images_file(run, subject)) as file:
        np.save(file, np.array(images)[used])
    write_arrays(subject_file(run, subject), arrays, {})  # last: it stands for both
    return len(rows)


def _registered(scan: Scan, finder: GroundTruth) -> tuple[dict, Registration | None]:
    """Row of a scan, and its registration, if it was found."""
    row = _refused(scan.name, "no face found")
    row["condition"] = np.array(scan.condition)
    detected = shared_detector().detect(scan.image)
    if detected is None:
        return row, None
    pixels = convert(detected, _FOUND, _KEPT)
    row["image"], row["crop_landmarks"] = crop(scan.image, pixels, CROP_SIZE, CROP_MARGIN)
    row["detected"] = pixels
    if scan.truth is not None:
        row["truth"], row["true_pixels"] = scan.truth, scan.pixels
    try:
        found = finder.register(pixels, scan.points)
    except InputError as error:
        return row | {"status": np.array(str(error))}, None
    row |= {
        "status": np.array(USED),
        "landmarks": found.landmarks,
        "fitted": found.fitted,
        "gaps": found.gaps,
        "rotation": found.fit.camera.rotation,
        "fit_rms": np.array(found.fit.rms),
        "icp_rms": np.array(found.icp.rms),
    }
    return row, found


def _some_points(scan: Scan, found: Registration) -> np.ndarray:
    """Points of a scan for a picture, in the frame of the face model: `(8000, 3)` millimetres."""
    rotation, translation = found.model_to_scan
    rng = np.random.default_rng(len(scan.points))
    chosen = rng.choice(len(scan.points), _EXAMPLE_POINTS, replace=True)
    return (scan.points[chosen] - translation) @ rotation


def _refused(name: str, status: str) -> dict:
    """A row of a scan that gives no test face."""
    unknown = np.full((len(load_scheme(_KEPT)), 3), np.nan)
    return {
        "name": np.array(name),
        "condition": np.array(""),
        "status": np.array(status),
        "image": np.zeros((CROP_SIZE, CROP_SIZE, 3), np.uint8),
        "crop_landmarks": unknown[:, :2],
        "detected": unknown[:, :2],
        "true_pixels": unknown[:, :2],
        "truth": unknown,
        "landmarks": unknown,
        "fitted": unknown,
        "gaps": unknown[:, 0],
        "rotation": np.full((3, 3), np.nan),
        "fit_rms": np.array(np.nan),
        "icp_rms": np.array(np.nan),
    }


def subject_file(run: Run, subject: int) -> Path:
    return run.work / "scans" / f"{subject:03}.npz"


def images_file(run: Run, subject: int) -> Path:
    return subject_file(run, subject).with_suffix(".npy")


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


def check_index(run: Run, source: CasiaScans) -> None:
    """Write an index for the user to edit, if none was named, and forget what another one chose."""
    template = run.work / "casia-index.csv"
    if run.casia_index is None and not template.exists():
        casia.write_index(template, source.found)
        print(f"  all scans are used; to choose, edit {template} and name it by CASIA_INDEX=")
    # Subjects that a stopped run has done with another choice of scans are of no use.
    chosen, scans = run.work / "scans" / "index.csv", run.work / "scans"
    content = b"" if run.casia_index is None else run.casia_index.read_bytes()
    if scans.exists() and not (chosen.exists() and chosen.read_bytes() == content):
        shutil.rmtree(scans)
    write_bytes(chosen, content)


@functools.cache
def scan_source(run: Run) -> CasiaScans | ScansStandin:
    """Scans of a run: of CASIA-3D those that the index names, or the stand-in's."""
    folder, preset = run.folder_of("casia"), run.preset
    if folder is not None:
        return CasiaScans(folder, run.casia_index)
    seed = [run.seed, Stream.SCANS]
    return ScansStandin(_model(run), preset.scan_subjects, preset.scans, seed)


@functools.cache
def _finder(run: Run) -> GroundTruth:
    return GroundTruth(_model(run))


@functools.cache
def _model(run: Run) -> MorphableModel:
    return load_model(run.model, run.data, run.scheme)


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    scan_source.cache_clear()  # the index may have been edited since
    with stage(run, "scans") as record:
        model = _model(run)  # if it is missing, that is to be said first
        source = scan_source(run)
        record["source"] = f"stand-in, {model.name}"
        if isinstance(source, CasiaScans):
            record["source"] = "CASIA-3D"
            check_index(run, source)
        missing = [k for k in range(source.n_subjects) if not subject_file(run, k).exists()]
        done = source.n_scans - sum(source.scans_of(subject) for subject in missing)
        with Bar(total=source.n_scans, initial=done, desc="scans", unit="scan") as bar:
            for n in unordered(run.jobs, register_scans, ((run, k) for k in missing)):
                bar.update(n)
        record |= collect(run, source.n_subjects)
        shutil.rmtree(run.work / "scans")
        for status, n in record["scans"].items():
            print(f"  {n} {status}")
