"""Stage 4: the paper's BFM table, ours beside it: metrics, tables, figures and the manifest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from data_gen.views.projections import PROJECTIONS
from deepmds_keras.io.archives import read_arrays
from deepmds_keras.landmarks import load_scheme
from experiments.arguments import parse_run
from experiments.figures.curves import learning_curves
from experiments.figures.errors import error_per_pose
from experiments.figures.face_figures import draw_faces, draw_landmark_errors, drawn_of
from experiments.figures.renders import renders
from experiments.figures.style import save
from experiments.inputs import (
    Faces,
    image_files,
    load_faces,
)
from experiments.manifest import clear_results, records_of, write_manifest
from experiments.recipes import mobileface_file
from experiments.run import Run
from experiments.running import stage
from experiments.scoring.parameters import write_parameter_table
from experiments.scoring.scores import Scores, evaluate, load_predictions, metrics_by_seed
from experiments.tracks.bfm.released_evaluator import BESIDE, REMARKS, as_released
from experiments.tracks.results import load_histories, write_results

_RENDERS = 24


def draw(
    run: Run,
    test: Faces,
    scores: dict[str, Scores],
    predictions: dict[str, dict],
    folder: Path,
) -> None:
    """Write every figure, and the faces of the qualitative one as numbers."""
    figures = folder / "figures"
    scheme = load_scheme(run.scheme)
    drawn = drawn_of(scores)
    mobileface = None
    if "mobileface" in scores:
        files, first = image_files(run, "test"), range(min(_RENDERS, len(test.views)))
        figure = renders(files[slice(len(first))], files.landmarks(first), scheme)
        save(figure, figures, "renders")
        mobileface = read_arrays(mobileface_file(run))[1]["history"]
    save(learning_curves(load_histories(run), mobileface), figures, "learning_curves")

    titles, faces = typical_faces(test, scores["ours"].mse)
    frontal = predictions["ours"]["frontal"]
    draw_faces(folder, "qualitative", scheme, test, frontal, drawn, faces, titles)
    draw_landmark_errors(folder, scheme, test, drawn, run.track)

    cameras = test.cameras
    poses = pd.DataFrame(
        {
            "projection": np.array(PROJECTIONS)[cameras.projection],
            "yaw": cameras.yaw,
            "pitch": cameras.pitch,
        }
    )
    errors = [poses.assign(method=method, mse=own.mse) for method, own in drawn.items()]
    save(error_per_pose(pd.concat(errors, ignore_index=True)), figures, "error_per_pose")


def typical_faces(test: Faces, mse: np.ndarray) -> tuple[list[str], np.ndarray]:
    """One face for each kind of view: the one whose error is the median of its kind."""
    perspective = test.cameras.projection == PROJECTIONS.index("perspective")
    kinds = {
        f"orthographic\nyaw {yaw:+g}°": ~perspective & (test.cameras.yaw == yaw)
        for yaw in sorted(np.unique(test.cameras.yaw[~perspective]))
    }
    kinds["perspective"] = perspective
    kinds = {title: np.flatnonzero(members) for title, members in kinds.items() if members.any()}
    faces = [own[np.argsort(mse[own])[len(own) // 2]] for own in kinds.values()]
    return [title.replace("+0°", "0°").replace("-", "−") for title in kinds], np.array(faces)


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    folder = run.experiment_results(run.evaluation)
    folders = [folder]
    with stage(run, "bfm"):
        test = load_faces(run, "test")
        loaded = load_predictions(run)
        predictions = {method: arrays for method, (arrays, _) in loaded.items()}
        descriptions = {method: described for method, (_, described) in loaded.items()}
        released = run.evaluator == "released"
        if released:
            predictions = as_released(predictions, test.shapes)
        shapes = {method: arrays["shapes"] for method, arrays in predictions.items()}
        metrics, scores = evaluate(run, test, shapes, descriptions)
        remarks, beside = (REMARKS, BESIDE) if released else ({}, {})
        seeds = None if released else metrics_by_seed(run)
        write_results(run, folder, metrics, scores, remarks, beside, seeds)
        if not released:  # the other figures and tables are of the methods, however scored
            draw(run, test, scores, predictions, folder)
            parameters = run.model_results / "parameters"
            clear_results(parameters)
            write_parameter_table(run, metrics)
            folders.append(parameters)
        records = records_of(run, "bfm", own=False)
        for own in folders:
            write_manifest(run, "reproduce-bfm", records, own)
