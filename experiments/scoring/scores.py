"""Errors of each method's predictions: for every face, and for random subsets."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
import pandas as pd

from deepmds_keras import metrics
from deepmds_keras.errors import InputError
from deepmds_keras.files import read_arrays
from deepmds_keras.geometry.alignment import align, is_mirrored
from experiments.inputs import Faces
from experiments.records import read_record
from experiments.run import Run
from experiments.scoring.metrics import METRICS, Metric
from experiments.streams import Stream


def load_predictions(
    run: Run, methods: Iterable[str]
) -> dict[str, tuple[dict[str, np.ndarray], dict]]:
    """Arrays and description of methods' predictions, with jointly measured times, if any.

    Raises:
        InputError: The file of a method is missing or damaged.
    """
    measured = run.record_file("times")
    times = read_record(measured)["times"] if measured.exists() else {}
    predictions = {method: load_prediction(run, method) for method in methods}
    return {
        method: (arrays, description | times.get(method, {}))
        for method, (arrays, description) in predictions.items()
    }


def load_prediction(run: Run, method: str) -> tuple[dict[str, np.ndarray], dict]:
    """Arrays and description of one method's predictions."""
    return read_arrays(run.prediction_file(method))


def metrics_by_seed(run: Run) -> pd.DataFrame:
    """Rows of `method, seed, metric, value` for all seeds of a run.

    Raises:
        InputError: A seed was not trained.
    """
    files = {seed: replace(run, seed=seed).record_file("seed") for seed in run.all_seeds}
    rows = [
        (method, seed, metric, value)
        for seed, file in files.items()
        for method, metric, value in read_record(file)["rows"]
    ]
    return pd.DataFrame(rows, columns=["method", "seed", "metric", "value"])


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

    def __getitem__(self, faces: slice | np.ndarray | list[int]) -> Scores:
        """Some of the faces, by a slice, a mask or their numbers."""
        return Scores(*(getattr(self, field.name)[faces] for field in fields(self)))

    @cached_property
    def detected(self) -> np.ndarray:
        """`(n,)` whether the method found the face."""
        return np.isfinite(self.aligned).all((1, 2))

    @cached_property
    def mse(self) -> np.ndarray:
        """`(n,)` mean squared error over all coordinates, in squares of the unit of `truth`."""
        return self._of_detected(metrics.mse)

    @cached_property
    def depth_corr(self) -> np.ndarray:
        """`(n,)` trace depth correlation, at most L."""
        return self._of_detected(metrics.depth_corr)

    @property
    def depth_corr_across_faces(self) -> float:
        """Sum over landmarks of the correlation of depth across all faces, at most L."""
        return metrics.depth_corr_across_faces(self.aligned, self.truth)

    @cached_property
    def distances_mm(self) -> np.ndarray:
        """`(n, L)` distances to the truth, millimetres."""
        return np.linalg.norm(self.aligned - self.truth, axis=2) * self.unit_mm[:, None]

    def _of_detected(self, criterion: Callable) -> np.ndarray:
        values = np.full(len(self.aligned), np.nan)
        values[self.detected] = criterion(self.aligned[self.detected], self.truth[self.detected])
        return values


def score(shapes: np.ndarray, test: Faces) -> Scores:
    """Align predictions `(n, L, 3)` to the truth; a face that was not found is NaN."""
    detected = np.isfinite(shapes).all((1, 2))
    truth = test.shapes.astype(float)
    aligned, mirrored = np.full(shapes.shape, np.nan), np.full(len(shapes), np.nan)
    aligned[detected] = align(shapes[detected], truth[detected])
    mirrored[detected] = is_mirrored(shapes[detected], truth[detected])
    return Scores(aligned, truth, test.unit_mm, mirrored)


def evaluate(
    run: Run, test: Faces, shapes: dict[str, np.ndarray], descriptions: dict[str, dict]
) -> tuple[pd.DataFrame, dict[str, Scores]]:
    """Score every method, on all test faces and on the run's random subsets.

    Args:
        shapes: Method → `(n, L, 3)` predictions; NaN for a face that it did not find.
        descriptions: Method → the description stored with its predictions.

    Returns:
        Long table as in `metrics.csv`, and scores by method.
    """
    chosen = subsets(run, len(test.views))
    scores = {method: score(predicted, test) for method, predicted in shapes.items()}
    rows = [
        (method, metric.id, subset, value)
        for method in scores
        for metric in METRICS.values()
        if metric.is_of(run.track) and (metric.per_face or metric.per_subset)
        for subset, value in enumerate(_by_subset(metric, scores[method], chosen))
    ]
    rows += [
        (method, metric.id, None, description[metric.id])
        for method, description in descriptions.items()
        for metric in METRICS.values()
        if metric.is_cost and metric.id in description
    ]
    table = pd.DataFrame(rows, columns=["method", "metric", "subset", "value"])
    return table.astype({"subset": "Int64"}), scores


def per_face(
    scores: dict[str, Scores], subjects: np.ndarray | None = None
) -> dict[str, dict[str, np.ndarray]]:
    """Metric of the paper → method → its values on the faces that every method found.

    With the `subjects` `(n,)` of faces: the means of each subject's values.
    """
    detected = np.all([of_method.detected for of_method in scores.values()], axis=0)
    values = {
        metric.id: {method: metric.per_face(scores[method])[detected] for method in scores}
        for metric in METRICS.values()
        if metric.in_paper
    }
    if subjects is None:
        return values
    means = {m: pd.DataFrame(of).groupby(subjects[detected]).mean() for m, of in values.items()}
    return {metric: {m: of[m].to_numpy() for m in of} for metric, of in means.items()}


def landmark_errors(scores: dict[str, Scores]) -> dict[str, np.ndarray]:
    """Method → `(L,)` root-mean-square distances to the truth, millimetres."""
    return {m: np.sqrt(np.nanmean(s.distances_mm**2, axis=0)) for m, s in scores.items()}


def subsets(run: Run, n: int) -> np.ndarray:
    """Random subsets of n test faces, `(n_subsets, subset_size)` of their numbers.

    No face is twice in a subset.

    Raises:
        InputError: There are fewer faces than a subset has.
    """
    rng, preset = np.random.default_rng([run.seed, Stream.SUBSETS]), run.preset
    if n < preset.subset_size:
        raise InputError(
            f"There must be at least {preset.subset_size} test faces to draw a subset from. "
            f"Received {n}."
        )
    return np.array([rng.choice(n, preset.subset_size, False) for _ in range(preset.n_subsets)])


def _by_subset(metric: Metric, scores: Scores, chosen: np.ndarray) -> list[float]:
    """A metric on each subset, over the faces that the method found."""
    if metric.per_subset:
        return [metric.per_subset(scores[faces[scores.detected[faces]]]) for faces in chosen]
    values = metric.per_face(scores)
    known = np.isfinite(values)
    return [values[faces[known[faces]]].mean() for faces in chosen]
