"""Step of the FLAME track: test faces, with landmarks detected in photos and located on scans."""

import functools
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import numpy as np

from data_gen.datasets import casia
from data_gen.datasets.scans_substitute import Scan, ScansSubstitute
from data_gen.photographs import crop
from data_gen.registration import GroundTruth
from deepmds_keras.errors import InputError
from deepmds_keras.landmarks import convert
from experiments.datasets.detected_faces import find_faces
from experiments.inputs import CROP_MARGIN, CROP_SIZE, face_model
from experiments.records import listing, resumable
from experiments.run import Run
from experiments.streams import Stream

_EXAMPLES, _EXAMPLE_POINTS = 3, 8000  # scans kept for pictures


@functools.cache
def _source(run: Run) -> list[list[casia.CasiaScan]] | ScansSubstitute:
    """Scans of each subject of CASIA-3D, of those that the index names, or of the substitute."""
    folder = run.folder_of("casia")
    if folder is None:
        seed = [run.seed, Stream.SCANS]
        return ScansSubstitute(face_model(run), run.preset.scan_subjects, run.preset.scans, seed)
    scans = casia.find_scans(folder)
    if run.casia_index is not None:
        scans = casia.read_index(run.casia_index, scans)
    return [[*group] for _, group in groupby(scans, key=lambda scan: scan.name[:3])]


def scans_of_subject(run: Run, subject: int) -> Iterator[tuple]:
    """Name, image and data of each scan of a subject, and whether it is kept for pictures."""
    source = _source(run)
    scans = source.subject(subject) if isinstance(source, ScansSubstitute) else source[subject]
    for number, scan in enumerate(scans):
        try:
            if not isinstance(scan, Scan):
                scan = Scan(scan.name, scan.condition, *casia.load_scan(scan))
        except InputError as error:
            yield scan.name, error, None
        else:
            yield scan.name, scan.image, (scan, subject < _EXAMPLES and number == 0)


def register(
    run: Run, image: np.ndarray, detected: np.ndarray, known: tuple[Scan, bool]
) -> dict[str, np.ndarray]:
    """Columns of a scan's row in the table, for `find_faces`."""
    scan, is_example = known
    pixels = convert(detected, "ibug68", "ibug51")  # the paper leaves the detector's jaw line out
    registration = _ground_truth(run).register(pixels, scan.points)
    square, crop_landmarks = crop(image, pixels, CROP_SIZE, CROP_MARGIN)
    columns = {
        "condition": np.array(scan.condition),
        "image": square,
        "crop_landmarks": crop_landmarks,
        "detected": pixels,
        "view": pixels * (1, -1),
        "landmarks": registration.landmarks,
        "fitted": registration.fitted,
        "rotation": registration.fit.camera.rotation,
    }
    if scan.truth is not None:
        columns["truth"] = scan.truth
    if is_example:
        # Some points of the scan in the frame of the face model, millimetres.
        rotation, translation = registration.model_to_scan
        points = np.random.default_rng(0).choice(scan.points, _EXAMPLE_POINTS)
        columns["example"] = np.array(scan.name)
        columns["example_points"] = (points - translation) @ rotation
    return columns


@functools.cache
def _ground_truth(run: Run) -> GroundTruth:
    return GroundTruth(face_model(run))


def main(run: Run) -> dict:
    model = face_model(run)  # a missing one must be reported first
    source, folder = _source(run), run.folder_of("casia")
    index = [Path(run.casia_index)] if run.casia_index else []
    pieces = resumable(run.work / "scans", index, model=model.sha256, casia=listing(folder))
    if folder is None:
        sizes = [source.scans_of(subject) for subject in range(source.n_subjects)]
        name = f"substitute, {model.name}"
    else:
        sizes, name = [len(scans) for scans in source], "CASIA-3D"
        template = run.work / "casia-index.csv"
        if not index and not template.exists():
            casia.write_index(template, [scan for scans in source for scan in scans])
            # `make clean` deletes what is in `build`, and no manifest records it.
            print(f"  all scans are used; to choose, copy {template} to another folder than")
            print(f"  {run.build}, edit the copy, and name it by CASIA_INDEX=")
    return {"source": name} | find_faces(run, "scan", pieces, sizes, scans_of_subject, register)
