"""How far each method's predictions lie from the truth: for every face, and for random subsets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from deepmds_keras import metrics
from deepmds_keras.alignment import align, is_mirrored
from deepmds_keras.io.archives import read_arrays
from deepmds_keras.io.errors import InputError
from experiments.inputs import Faces
from experiments.records import load_record
from experiments.run import Run
from experiments.streams import Stream


def load_predictions(run: Run) -> dict[str, tuple[dict[str, np.ndarray], dict]]:
    """Arrays and description of the predictions of every method whose stage is complete."""
    methods = load_record(run, "predictions")["methods"]
    for name in ("mobileface", "mediapipe", run.ringnet_stage):
        if (run.work / f"{name}.json").exists():
            methods = methods + load_record(run, name).get("methods", [name])
    return {method: load_prediction(run, method) for method in methods}


def load_prediction(run: Run, method: str) -> tuple[dict[str, np.ndarray], dict]:
    """Arrays and description of a method's predictions."""
    return read_arrays(run.prediction_file(method))


def costs(descriptions: dict[str, dict]) -> pd.DataFrame:
    """Long table `method, metric, value` of the time of a prediction and the parameters."""
    rows = [
        (method, metric, described[metric])
        for method, described in descriptions.items()
        for metric in ("ms_per_face", "n_parameters")
        if metric in described
    ]
    return pd.DataFrame(rows, columns=["method", "metric", "value"])


@dataclass(frozen=True, eq=False)
class Scores:
    """One method on all test faces, after Procrustes with scale and reflection onto the truth.

    Numbers of a face that the method did not find are NaN.

    Attributes:
        aligned: `(n, L, 3)` predictions in the frame and unit of the truth.
        mse: `(n,)` mean squared error over all coordinates, in the unit of `normalise`.
        mse_mm2: `(n,)` the same in square millimetres.
        depth_corr: `(n,)` trace depth correlation, at most L.
        mirrored: `(n,)` 1 where the alignment had to reflect the prediction, else 0.
    """

    aligned: np.ndarray
    mse: np.ndarray
    mse_mm2: np.ndarray
    depth_corr: np.ndarray
    mirrored: np.ndarray


def score(shapes: np.ndarray, test: Faces) -> Scores:
    """Align predictions `(n, L, 3)` to the truth and measure what is left."""
    found = np.isfinite(shapes).all((1, 2))
    truth = test.shapes[found].astype(float)
    aligned = align(shapes[found], truth)
    mse = metrics.mse(aligned, truth)

    def of_all(values: np.ndarray) -> np.ndarray:
        everywhere = np.full((len(shapes), *values.shape[1:]), np.nan)
        everywhere[found] = values
        return everywhere

    return Scores(
        aligned=of_all(aligned),
        mse=of_all(mse),
        mse_mm2=of_all(mse) * test.unit_mm**2,
        depth_corr=of_all(metrics.depth_corr(aligned, truth)),
        mirrored=of_all(is_mirrored(shapes[found], truth)),
    )


def evaluate(
    run: Run, test: Faces, shapes: dict[str, np.ndarray], descriptions: dict[str, dict]
) -> tuple[pd.DataFrame, dict[str, Scores]]:
    """Score every method, on all test faces and on the run's random subsets.

    Args:
        run: The run.
        test: Test faces.
        shapes: Method to `(n, L, 3)` predictions; NaN for a face that it did not find.
        descriptions: Method to what its prediction's stage wrote of it.

    Returns:
        Long table as in `metrics.csv`, and scores by method.
    """
    chosen = subsets(run, len(test.views))
    scores = {method: score(own, test) for method, own in shapes.items()}
    may_miss = run.track == "flame"  # where methods look for the face in a photo
    rows = [subset_metrics(method, own, test, chosen, may_miss) for method, own in scores.items()]
    metrics = pd.concat([*rows, costs(descriptions)], ignore_index=True)
    metrics["subset"] = metrics["subset"].astype("Int64")
    return metrics, scores


def per_face(scores: dict[str, Scores]) -> dict[str, dict[str, np.ndarray]]:
    """Metric to method to its values on the faces that every method found."""
    found = np.all([np.isfinite(own.mse) for own in scores.values()], axis=0)
    return {
        metric: {method: getattr(own, metric)[found] for method, own in scores.items()}
        for metric in ("mse", "depth_corr")
    }


def landmark_errors(scores: dict[str, Scores], test: Faces) -> dict[str, np.ndarray]:
    """Method to `(L,)` root-mean-square distances to the truth, millimetres."""
    distances = {
        method: np.linalg.norm(own.aligned - test.shapes, axis=2) * test.unit_mm[:, None]
        for method, own in scores.items()
    }
    return {method: np.sqrt(np.nanmean(own**2, axis=0)) for method, own in distances.items()}


def subsets(run: Run, n: int) -> np.ndarray:
    """Random ones of n test faces, `(n_subsets, subset_size)`, none twice in a subset."""
    rng, preset = np.random.default_rng([run.seed, Stream.SUBSETS]), run.preset
    if n < preset.subset_size:
        raise InputError(
            f"There must be at least {preset.subset_size} test faces to draw a subset from. "
            f"Received {n}."
        )
    return np.array([rng.choice(n, preset.subset_size, False) for _ in range(preset.n_subsets)])


def subset_metrics(
    method: str, scores: Scores, test: Faces, chosen: np.ndarray, may_miss: bool
) -> pd.DataFrame:
    """Long table `method, metric, subset, value` of one method, over the faces that it found.

    If it may miss some, also of the share that it found.
    """
    found = np.isfinite(scores.mse)
    groups = [faces[found[faces]] for faces in chosen]
    values = {
        metric: [getattr(scores, metric)[faces].mean() for faces in groups]
        for metric in ("mse", "mse_mm2", "depth_corr")
    }
    values |= {
        "depth_corr_across_faces": [
            metrics.depth_corr_across_faces(scores.aligned[faces], test.shapes[faces])
            for faces in groups
        ],
        "mirrored_fraction": [scores.mirrored[faces].mean() for faces in groups],
    }
    if may_miss:
        values["found_fraction"] = found[chosen].mean(1)
    rows = [
        (method, metric, subset, value)
        for metric, by_subset in values.items()
        for subset, value in enumerate(by_subset)
    ]
    return pd.DataFrame(rows, columns=["method", "metric", "subset", "value"])
