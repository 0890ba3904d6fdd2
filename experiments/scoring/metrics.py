"""The metrics of the tables: a new row here is a new column there."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from experiments.scoring.published import published

_NOT_LATEX = ("terminal",)


@dataclass(frozen=True, kw_only=True)
class Metric:
    """A metric and the column that shows it.

    At most one of `per_face`, `per_subset` and `derived` defines how it is computed. Without any,
    the prediction step measures it and writes it, under the id, to its description.

    Attributes:
        id: As in `metrics.csv` and `table.csv`.
        head: Name in tables.
        legend: Definition, for below the tables; `{n}` stands for the number of landmarks.
        scale: Text after the name in the table of one experiment: `{n}` as above, `{power}` for the
            power of ten in which the paper prints the metric there.
        better: `"higher"`, `"lower"`, or empty for neither.
        per_face: Returns `(n,)` values from `scores.Scores`; a subset gets the mean of those not
            NaN.
        per_subset: Returns a number from the `Scores` of the detected faces of a subset.
        derived: Id of another metric and a function of its value on each subset. `metrics.csv`
            has the other metric only.
        in_paper: Whether the paper prints it: two columns, paper and here, and Wilcoxon's tests.
        over_seeds: Whether tables have columns for its median and range over seeds.
        decimals: Decimals of a mean shown without its s.d.; None gives three significant digits.
        shown: Outputs with this column: `"terminal"`, whose columns the report has too, and
            `"latex"`. The CSV files hold every metric.
        tracks: Tracks on which it is measured; None for all.
    """

    id: str
    head: str
    legend: str
    scale: str = ""
    better: str = ""
    per_face: Callable[..., np.ndarray] | None = None
    per_subset: Callable[..., float] | None = None
    derived: tuple[str, Callable[[np.ndarray], np.ndarray]] | None = None
    in_paper: bool = False
    over_seeds: bool = False
    decimals: int | None = None
    shown: tuple[str, ...] = ("terminal", "latex")
    tracks: tuple[str, ...] | None = None

    def definition(self, n: int) -> str:
        """Explanation of the column, with n landmarks, and which values are better."""
        better = f", {self.better} is better" if self.better else ""
        return self.legend.format(n=n) + better

    def is_of(self, track: str) -> bool:
        """Whether it is measured on a track."""
        return self.tracks is None or track in self.tracks

    @property
    def is_cost(self) -> bool:
        """Whether the step that predicts measures it."""
        return not (self.per_face or self.per_subset or self.derived)


# In the order of `metrics.csv`.
METRICS = {
    metric.id: metric
    for metric in (
        Metric(
            id="mse",
            head="MSE",
            scale=" ({power})",
            legend="mean square over coordinates (the paper's avgMSE) after Procrustes alignment "
            "with scale and reflection, in squares of the min-max unit of a face",
            better="lower",
            per_face=lambda scores: scores.mse,
            in_paper=True,
            over_seeds=True,
        ),
        Metric(
            id="mse_mm2",
            head="MSE (mm²)",
            legend="the same mean square in square millimetres",
            better="lower",
            per_face=lambda scores: scores.mse * scores.unit_mm**2,
            shown=(),
        ),
        Metric(
            id="rmse_mm",
            head="RMSE (mm)",
            legend="root of the mean square in millimetres, per coordinate",
            better="lower",
            derived=("mse_mm2", np.sqrt),
            decimals=2,
        ),
        Metric(
            id="depth_corr",
            head="Depth correlation",
            scale=" (of {n})",
            legend="trace of the landmarks' correlation matrix (the paper's avgDepthCorr), at most "
            "{n}",
            better="higher",
            per_face=lambda scores: scores.depth_corr,
            in_paper=True,
        ),
        Metric(
            id="depth_corr_across_faces",
            head="Across faces",
            legend="sum over landmarks of the absolute correlation of depth across faces, at "
            "most {n}",
            better="higher",
            per_subset=lambda scores: scores.depth_corr_across_faces,
            decimals=2,
        ),
        Metric(
            id="reflection_rate",
            head="Mirrored",
            legend="share of faces that the alignment had to reflect",
            per_face=lambda scores: scores.mirrored,
            decimals=2,
            shown=_NOT_LATEX,
        ),
        Metric(
            id="detection_rate",
            head="Found",
            legend="share of photos in which a method found the face",
            per_face=lambda scores: scores.detected,
            decimals=2,
            shown=_NOT_LATEX,
            tracks=("flame",),  # where methods look for the face in a photo
        ),
        Metric(
            id="ms_per_face",
            head="ms/face",
            legend="time of a prediction, median of several taken in turns",
            shown=_NOT_LATEX,
        ),
        *(
            Metric(
                id=f"ms_per_face_{end}",
                head=f"ms/face, {end}",
                legend=f"{end} time of a prediction",
                shown=(),
            )
            for end in ("lowest", "highest")
        ),
        Metric(
            id="n_parameters",
            head="Parameters",
            legend="trainable parameters",
            shown=_NOT_LATEX,
        ),
    )
}


def metrics_of(experiment: str) -> list[Metric]:
    """Metrics of the tables of an experiment: the paper's first, in its order."""
    order = [*dict.fromkeys(published(experiment)["metric"])]
    metrics = [metric for metric in METRICS.values() if metric.is_of(experiment)]
    return sorted(metrics, key=lambda m: order.index(m.id) if m.in_paper else len(order))
