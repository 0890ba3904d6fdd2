"""Stage 4: the paper's BFM table, ours beside it: metrics, tables, figures and the manifest."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd

from data_gen.landmarks import load_scheme
from data_gen.projections import PROJECTIONS
from deepmds_keras.weights import read_arrays
from experiments.faces import SCHEME, Faces, load_faces
from experiments.figures.curves import learning_curves
from experiments.figures.errors import error_per_landmark, error_per_pose
from experiments.figures.qualitative import qualitative
from experiments.figures.style import save
from experiments.figures.summary import summary
from experiments.manifest import write_manifest
from experiments.methods import DEEP_MDS, network_names
from experiments.run import Run, parse_run, stage, write_text
from experiments.scores import (
    Scores,
    costs,
    load_prediction,
    score,
    subset_metrics,
    subsets,
)
from experiments.tables import to_csv, write_tables

# Why a method of the paper's table has no number of ours.
_NOT_RUN = {
    "mobileface": "needs rendered images, which are not part of this experiment yet",
    "authors_weights": "their weight files were not given (AUTHORS=folder)",
}
_STAGES = ("faces", "networks", "predictions")
# Drawn in the figures; the others differ from these in training or test views only.
_DRAWN = ("mean_shape", "linear", "zhao", "aldrian", *DEEP_MDS, "authors_weights")
_MAPPED = ("mean_shape", "linear", "zhao", "ours", "ours_stable")  # their errors as whole faces


def evaluate(
    run: Run, test: Faces, methods: list[str]
) -> tuple[pd.DataFrame, dict[str, Scores], dict[str, dict]]:
    """Scores of the methods that made predictions.

    Returns:
        Long table as in `metrics.csv`, scores by method, and the predictions' arrays by method.

    Raises:
        InputError: The predictions of a method are missing or damaged.
    """
    chosen = subsets(run)
    loaded = {method: load_prediction(run, method) for method in methods}
    predictions = {method: arrays for method, (arrays, _) in loaded.items()}
    scores = {method: score(arrays["shapes"], test) for method, arrays in predictions.items()}
    rows = [subset_metrics(method, own, test, chosen) for method, own in scores.items()]
    descriptions = {method: described for method, (_, described) in loaded.items()}
    metrics = pd.concat([*rows, costs(descriptions)], ignore_index=True)
    metrics["subset"] = metrics["subset"].astype("Int64")
    return metrics, scores, predictions


def histories(run: Run) -> dict[str, dict[str, dict]]:
    """Losses of `DEEP_MDS` by method, network and epoch, from the files of the networks."""
    return {
        method: {
            network: read_arrays(run.network_file(name))[1]["history"]
            for network, name in network_names(method).items()
        }
        for method in DEEP_MDS
    }


def draw(
    run: Run,
    test: Faces,
    scores: dict[str, Scores],
    predictions: dict[str, dict],
    table: pd.DataFrame,
    folder: Path,
) -> None:
    """Write every figure."""
    scheme = load_scheme(SCHEME)
    drawn = {method: scores[method] for method in _DRAWN if method in scores}
    save(summary(table), folder, "summary")
    save(learning_curves(histories(run)), folder, "learning_curves")

    titles, faces = typical_faces(test, scores["ours"].mse)
    figure = qualitative(
        test.views[faces],
        predictions["ours"]["frontal"][faces],
        test.shapes[faces],
        {method: own.aligned[faces] for method, own in drawn.items()},
        scheme,
        titles,
        {method: own.mse[faces] for method, own in drawn.items()},
    )
    save(figure, folder, "qualitative")

    distances = {
        method: np.linalg.norm(own.aligned - test.shapes, axis=2) * test.unit_mm[:, None]
        for method, own in drawn.items()
    }
    errors = {method: np.sqrt(np.mean(own**2, axis=0)) for method, own in distances.items()}
    figure = error_per_landmark(errors, scheme, test.shapes.mean(0), _MAPPED)
    save(figure, folder, "error_per_landmark")

    cameras = test.cameras
    poses = pd.DataFrame(
        {
            "projection": np.array(PROJECTIONS)[cameras.projection],
            "yaw": cameras.yaw,
            "pitch": cameras.pitch,
        }
    )
    errors = [poses.assign(method=method, mse=own.mse) for method, own in drawn.items()]
    save(error_per_pose(pd.concat(errors, ignore_index=True)), folder, "error_per_pose")


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
    folder = run.experiment_results("bfm")
    with stage(run, "bfm"):
        stages = [json.loads((run.work / f"{name}.json").read_text()) for name in _STAGES]
        test = load_faces(run, "test")
        metrics, scores, predictions = evaluate(run, test, stages[-1]["methods"])
        write_text(folder / "metrics.csv", to_csv(metrics))
        table = write_tables(
            folder,
            metrics,
            experiment="bfm",
            subset_size=run.preset.subset_size,
            notes={method: why for method, why in _NOT_RUN.items() if method not in scores},
            per_face={
                metric: {method: getattr(own, metric) for method, own in scores.items()}
                for metric in ("mse", "depth_corr")
            },
        )
        draw(run, test, scores, predictions, table, folder / "figures")
        write_manifest(run, "reproduce-bfm", stages, folder)


if __name__ == "__main__":
    main()
