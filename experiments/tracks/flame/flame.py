"""Last stage of the FLAME track: the paper's CASIA-3D table, ours beside it, figures, manifest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from data_gen.datasets.image_files import ImageFiles
from data_gen.rendering.crops import crop
from deepmds_keras.io.archives import read_arrays
from deepmds_keras.landmarks import load_scheme
from experiments.arguments import parse_run
from experiments.figures.curves import learning_curves
from experiments.figures.errors import error_per_condition
from experiments.figures.face_figures import draw_faces, draw_landmark_errors, drawn_of
from experiments.figures.ground_truth import Example, ground_truth
from experiments.figures.qualitative import Photos
from experiments.figures.style import save
from experiments.inputs import (
    USED,
    Faces,
    crop_files,
    load_faces,
    of_used,
)
from experiments.manifest import records_of, write_manifest
from experiments.run import Run
from experiments.running import stage
from experiments.scoring.scores import Scores, evaluate, load_predictions
from experiments.tracks.results import load_histories, write_results

_TRUE, _FOUND, _FIT = "true_landmarks", "scan_landmarks", "model_fit"
_SHOWN_FACES = 4
_PHOTO, _MARGIN = 112, 1.4  # of photos in the pictures: pixels of a side, see `crop`


def load_scans(run: Run) -> dict[str, np.ndarray]:
    """Table of every scan, the unused ones too, as `scans.register_scans` writes it."""
    return read_arrays(run.work / "scans.npz")[0]


def draw(
    run: Run,
    test: Faces,
    scans: dict[str, np.ndarray],
    scores: dict[str, Scores],
    frontal: np.ndarray,
    folder: Path,
) -> None:
    """Write the figures that are of the methods and of the test set, and faces as numbers."""
    figures = folder / "figures"
    scheme = load_scheme(run.scheme)
    drawn = drawn_of(scores)
    ringnet = None
    if "ringnet" in scores and run.ringnet is None:
        # The other record, of the landmarks' error alone, is in another unit.
        ringnet = {"train": read_arrays(run.network_file("ringnet"))[1]["history"]["train"]}
    save(learning_curves(load_histories(run), ringnet=ringnet), figures, "learning_curves")

    conditions = of_used(scans, "condition")
    faces = shown_faces(conditions, scores)
    files = crop_files(run, len(test.views))
    photos = Photos(*map(np.stack, zip(*(small_photo(files, k) for k in faces), strict=True)))
    titles = [conditions[k].replace("_", " ") for k in faces]
    draw_faces(folder, "casia", scheme, test, frontal, drawn, faces, titles, photos)
    draw_landmark_errors(folder, scheme, test, drawn, run.track)
    if len({*conditions}) > 1:
        rows = [
            pd.DataFrame({"method": method, "condition": conditions, "mse": own.mse})
            for method, own in drawn.items()
        ]
        save(error_per_condition(pd.concat(rows)), figures, "error_per_expression")
    if kept := examples(scans, files):
        save(ground_truth(kept, scheme, *found_and_true(scans)), figures, "scans")


def shown_faces(conditions: np.ndarray, scores: dict[str, Scores]) -> np.ndarray:
    """Faces of the median error of `ours` for each of some conditions, and one that is N/A.

    Where the conditions are not known, faces from a small error of `ours` to a large one.
    """
    mse = scores["ours"].mse
    names = [*dict.fromkeys(conditions)]
    groups = [np.flatnonzero(conditions == name) for name in names]
    if len(names) == 1:
        groups = np.array_split(np.argsort(mse), min(_SHOWN_FACES, len(mse)))
    faces = [own[np.argsort(mse[own])[len(own) // 2]] for own in groups]
    missing = [np.flatnonzero(np.isnan(own.mse)) for own in scores.values()]
    missing = next((faces for faces in missing if len(faces)), [])
    return np.array([*faces[: _SHOWN_FACES - bool(len(missing))], *missing[:1]])


def small_photo(files: ImageFiles, face: int) -> tuple[np.ndarray, np.ndarray]:
    """The middle of a test photo, `(112, 112, 3)`, and the landmarks in its pixels."""
    return crop(files[[face]][0], files.landmarks(range(face, face + 1))[0], _PHOTO, _MARGIN)


def examples(scans: dict[str, np.ndarray], files: ImageFiles) -> list[Example]:
    """The scans whose points were kept."""
    used = np.flatnonzero(scans["status"] == USED)
    found = []
    kept = (scans.get(key, ()) for key in ("example", "example_points"))
    for number, points in zip(*kept, strict=True):
        face = int(np.searchsorted(used, number))
        truth = scans["truth"][number]
        image, detected = small_photo(files, face)
        found.append(
            Example(
                image=image,
                detected=detected,
                points=points,
                fitted=scans["fitted"][number],
                found=scans["landmarks"][number],
                truth=None if np.isnan(truth).any() else truth,
            )
        )
    return found


def found_and_true(scans: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray | None]:
    """Landmarks found on the scans, and the true ones if they are known: `(n, 51, 3)` mm."""
    truth = of_used(scans, "truth")
    return of_used(scans, "landmarks"), None if np.isnan(truth).any() else truth


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    with stage(run, "flame"):
        test, scans = load_faces(run, "test"), load_scans(run)
        loaded = load_predictions(run)
        shapes = {method: arrays["shapes"] for method, (arrays, _) in loaded.items()}
        descriptions = {method: described for method, (_, described) in loaded.items()}
        shapes[_FIT] = of_used(scans, "fitted")
        found, truth = found_and_true(scans)
        here = shapes if truth is None else shapes | {_TRUE: truth}
        folder = run.experiment_results("flame")
        metrics, scores = evaluate(run, test, here, descriptions)
        write_results(run, folder, metrics, scores)
        draw(run, test, scans, scores, loaded["ours"][0]["frontal"], folder)
        folders = [folder]
        if truth is not None:
            folders.append(run.experiment_results("flame-true-landmarks"))
            true_test = test.against(truth)
            metrics, scores = evaluate(run, true_test, shapes | {_FOUND: found}, descriptions)
            write_results(run, folders[1], metrics, scores)
        records = records_of(run, "flame", own=False)
        for own in folders:
            write_manifest(run, "reproduce-flame", records, own)
