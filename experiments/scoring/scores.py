"""Errors of each method's predictions: for every face, and for random subsets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
import pandas as pd

from deepmds_keras import metrics
from deepmds_keras.alignment import align, is_mirrored
from deepmds_keras.io.archives import read_arrays
from deepmds_keras.io.errors import InputError
from experiments.inputs import Faces
from experiments.methods import METHODS
from experiments.metrics import METRICS
from experiments.records import load_record
from experiments.run import Run
from experiments.streams import Stream


def load_predictions(run: Run) -> dict[str, tuple[dict[str, np.ndarray], dict]]:
    """Arrays and description of the predictions of every method whose stage is complete."""
    record = load_record(run, "predictions")
    methods, times = record["methods"], record.get("times", {})
    others = {method.stage for method in METHODS.values()} - {"predictions", None}
    for name in sorted(others):
        name = run.ringnet_stage if name == "ringnet" else name
        if (run.work / f"{name}.json").exists():
            methods = methods + load_record(run, name).get("methods", [name])
    found = {method: load_prediction(run, method) for method in methods}
    return {m: (arrays, told | times.get(m, {})) for m, (arrays, told) in found.items()}


def load_prediction(run: Run, method: str) -> tuple[dict[str, np.ndarray], dict]:
    """Arrays and description of a method's predictions."""
    return read_arrays(run.prediction_file(method))


def runs_by_seed(run: Run) -> list[Run]:
    """The same run from each seed of `make seeds`; the first is its own."""
    return [replace(run, seed=run.seed + k) for k in range(run.n_seeds)]


def metrics_by_seed(run: Run) -> pd.DataFrame | None:
    """Rows of `method, seed, metric, value` of the seeds that were trained; None: its own alone.

    How many there are the stage tells that trained them, whatever the run asks for now.
    """
    if not run.record_file("seeds").exists():
        return None
    trained = replace(run, seeds=load_record(run, "seeds")["n_seeds"])
    rows = [
        (method, own.seed, metric, value)
        for own in runs_by_seed(trained)
        for method, metric, value in load_record(own, "seed")["rows"]
    ]
    return pd.DataFrame(rows, columns=["method", "seed", "metric", "value"])


def costs(descriptions: dict[str, dict]) -> pd.DataFrame:
    """Long table `method, metric, value` of what the stages that predict measured."""
    rows = [
        (method, metric.id, described[metric.id])
        for method, described in descriptions.items()
        for metric in METRICS.values()
        if metric.is_cost and metric.id in described
    ]
    return pd.DataFrame(rows, columns=["method", "metric", "value"])


@dataclass(frozen=True, eq=False)
class Scores:
    """One method on all test faces, after Procrustes with scale and reflection onto the truth.

    Numbers of a face that the method did not find are NaN.

    Attributes:
        aligned: `(n, L, 3)` predictions in the frame and unit of the truth.
        truth: `(n, L, 3)`, in the unit of `normalise`.
        unit_mm: `(n,)` millimetres that 1 stands for in `truth`.
        mirrored: `(n,)` 1 where the alignment had to reflect the prediction, else 0.
    """

    aligned: np.ndarray
    truth: np.ndarray
    unit_mm: np.ndarray
    mirrored: np.ndarray

    def __getitem__(self, faces) -> Scores:
        """Some of the faces, by a slice, a mask or their numbers."""
        return Scores(*(getattr(self, field.name)[faces] for field in fields(self)))

    @cached_property
    def found(self) -> np.ndarray:
        """`(n,)` whether the method found the face."""
        return np.isfinite(self.aligned).all((1, 2))

    @cached_property
    def mse(self) -> np.ndarray:
        """`(n,)` mean squared error over all coordinates, in squares of the unit of `truth`."""
        return self._of_found(metrics.mse)

    @cached_property
    def depth_corr(self) -> np.ndarray:
        """`(n,)` trace depth correlation, at most L."""
        return self._of_found(metrics.depth_corr)

    @cached_property
    def distances_mm(self) -> np.ndarray:
        """`(n, L)` distances to the truth, millimetres."""
        return np.linalg.norm(self.aligned - self.truth, axis=2) * self.unit_mm[:, None]

    def _of_found(self, criterion: Callable) -> np.ndarray:
        values = np.full(len(self.aligned), np.nan)
        values[self.found] = criterion(self.aligned[self.found], self.truth[self.found])
        return values


def score(shapes: np.ndarray, test: Faces) -> Scores:
    """Align predictions `(n, L, 3)` to the truth; a face that was not found is NaN."""
    found = np.isfinite(shapes).all((1, 2))
    truth = test.shapes.astype(float)
    aligned, mirrored = np.full(shapes.shape, np.nan), np.full(len(shapes), np.nan)
    aligned[found] = align(shapes[found], truth[found])
    mirrored[found] = is_mirrored(shapes[found], truth[found])
    return Scores(aligned, truth, test.unit_mm, mirrored)


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
    rows = [subset_metrics(method, own, chosen, run.track) for method, own in scores.items()]
    table = pd.concat([*rows, costs(descriptions)], ignore_index=True)
    table["subset"] = table["subset"].astype("Int64")
    return table, scores


def per_face(scores: dict[str, Scores]) -> dict[str, dict[str, np.ndarray]]:
    """The paper's metrics to method to its values on the faces that every method found."""
    found = np.all([own.found for own in scores.values()], axis=0)
    return {
        metric.id: {method: metric.per_face(own)[found] for method, own in scores.items()}
        for metric in METRICS.values()
        if metric.in_paper
    }


def landmark_errors(scores: dict[str, Scores]) -> dict[str, np.ndarray]:
    """Method to `(L,)` root-mean-square distances to the truth, millimetres."""
    return {m: np.sqrt(np.nanmean(own.distances_mm**2, axis=0)) for m, own in scores.items()}


def subsets(run: Run, n: int) -> np.ndarray:
    """Random ones of n test faces, `(n_subsets, subset_size)`, none twice in a subset."""
    rng, preset = np.random.default_rng([run.seed, Stream.SUBSETS]), run.preset
    if n < preset.subset_size:
        raise InputError(
            f"There must be at least {preset.subset_size} test faces to draw a subset from. "
            f"Received {n}."
        )
    return np.array([rng.choice(n, preset.subset_size, False) for _ in range(preset.n_subsets)])


def subset_metrics(method: str, scores: Scores, chosen: np.ndarray, track: str) -> pd.DataFrame:
    """Long table `method, metric, subset, value` of one method, over the faces that it found.

    Args:
        method: Its id.
        scores: On all test faces.
        chosen: Faces of the subsets, as from `subsets`.
        track: Whose metrics are computed.
    """
    rows = []
    for metric in METRICS.values():
        if not metric.is_of(track):
            continue
        if metric.per_face is not None:
            values = metric.per_face(scores)
            known = np.isfinite(values)
            by_subset = [values[faces[known[faces]]].mean() for faces in chosen]
        elif metric.per_subset is not None:
            by_subset = [metric.per_subset(scores[faces[scores.found[faces]]]) for faces in chosen]
        else:
            continue
        rows += [(method, metric.id, subset, value) for subset, value in enumerate(by_subset)]
    return pd.DataFrame(rows, columns=["method", "metric", "subset", "value"])
