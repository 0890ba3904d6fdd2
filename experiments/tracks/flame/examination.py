"""What is found in one scan after the other: landmarks in the photo, and from them on the scan."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from data_gen.datasets import casia
from data_gen.datasets.scans import Scan
from data_gen.fitting.ground_truth import GroundTruth, Registration
from data_gen.rendering.crops import crop
from deepmds_keras.detection.dlib_landmarks import shared_detector
from deepmds_keras.io.atomic import whole_file
from deepmds_keras.io.errors import InputError
from deepmds_keras.weights import write_arrays
from experiments.inputs import CROP_MARGIN, CROP_SIZE, USED
from experiments.run import Run, one_core

_JAW = 17  # leading landmarks of the detector that the paper leaves out
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


def examine(run: Run, source, finder: GroundTruth, subject: int) -> int:
    """Write what was found in each scan of one subject.

    Returns:
        Number of scans.
    """
    rows, example = [], {}
    with one_core():
        for scan in source.subject(subject):
            if isinstance(scan, tuple):
                rows.append(_refused(*scan))
                continue
            row, found = _examined(scan, finder)
            if found is not None and subject < _EXAMPLES and not example:
                points = _some_points(scan, found)
                example = {"example": np.array([len(rows)]), "example_points": points[None]}
            rows.append(row)
    used = np.array([row["status"] == USED for row in rows])
    images = [row.pop("image") for row in rows]
    arrays = {key: np.stack([row[key] for row in rows]) for key in rows[0]} | example
    with whole_file(images_file(run, subject)) as file:
        np.save(file, np.array(images)[used])
    write_arrays(subject_file(run, subject), arrays, {})  # last: it stands for both
    return len(rows)


def _examined(scan: Scan, finder: GroundTruth) -> tuple[dict, Registration | None]:
    """What is written of a scan, and how its truth was found, if it was."""
    row = _refused(scan.name, "no face found")
    row["condition"] = np.array(scan.condition)
    detected = shared_detector().detect(scan.image)
    if detected is None:
        return row, None
    pixels = detected[_JAW:]
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
        "rotation": found.fit.rotation,
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
    unknown = np.full((51, 3), np.nan)
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
