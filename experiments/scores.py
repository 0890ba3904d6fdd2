"""How far each method's predictions lie from the truth: for every face, and for random subsets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from deepmds_keras import metrics
from deepmds_keras.alignment import align, is_mirrored
from deepmds_keras.weights import read_arrays
from experiments.faces import Faces
from experiments.run import Run, load_record

# Streams of random numbers of a run beside those of its two data sets.
_SUBSETS = 2


def load_predictions(run: Run) -> dict[str, tuple[dict[str, np.ndarray], dict]]:
    """Arrays and description of the predictions of every method whose stage is complete."""
    methods = load_record(run, "predictions")["methods"]
    methods = methods + ["mobileface"] * (run.work / "mobileface.json").exists()
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
    ]
    return pd.DataFrame(rows, columns=["method", "metric", "value"])


@dataclass(frozen=True, eq=False)
class Scores:
    """One method on all test faces, after Procrustes with scale and reflection onto the truth.

    Attributes:
        aligned: `(n, L, 3)` predictions in the frame and unit of the truth.
        mse: `(n,)` mean squared error over all coordinates, in the unit of `normalise`.
        mse_mm2: `(n,)` the same in square millimetres.
        depth_corr: `(n,)` trace depth correlation, at most L.
        mirrored: `(n,)` whether the alignment had to reflect the prediction.
    """

    aligned: np.ndarray
    mse: np.ndarray
    mse_mm2: np.ndarray
    depth_corr: np.ndarray
    mirrored: np.ndarray


def score(shapes: np.ndarray, test: Faces) -> Scores:
    """Align predictions `(n, L, 3)` to the truth and measure what is left."""
    truth = test.shapes.astype(float)
    aligned = align(shapes, truth)
    mse = metrics.mse(aligned, truth)
    return Scores(
        aligned=aligned,
        mse=mse,
        mse_mm2=mse * test.unit_mm**2,
        depth_corr=metrics.depth_corr(aligned, truth),
        mirrored=is_mirrored(shapes, truth),
    )


def subsets(run: Run) -> np.ndarray:
    """Random test faces, `(n_subsets, subset_size)`: without repetition within a subset."""
    rng = np.random.default_rng([run.seed, _SUBSETS])
    n, preset = run.preset.test_faces, run.preset
    return np.array([rng.choice(n, preset.subset_size, False) for _ in range(preset.n_subsets)])


def subset_metrics(method: str, scores: Scores, test: Faces, chosen: np.ndarray) -> pd.DataFrame:
    """Long table `method, metric, subset, value` of one method."""
    values = {
        "mse": scores.mse[chosen].mean(1),
        "mse_mm2": scores.mse_mm2[chosen].mean(1),
        "depth_corr": scores.depth_corr[chosen].mean(1),
        "depth_corr_across_faces": [
            metrics.depth_corr_across_faces(scores.aligned[faces], test.shapes[faces])
            for faces in chosen
        ],
        "mirrored_fraction": scores.mirrored[chosen].mean(1),
    }
    rows = [
        (method, metric, subset, value)
        for metric, by_subset in values.items()
        for subset, value in enumerate(by_subset)
    ]
    return pd.DataFrame(rows, columns=["method", "metric", "subset", "value"])
