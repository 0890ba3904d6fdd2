"""Numbers with intervals, from the tables of results on one face model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import binom, binomtest, chi2, ttest_1samp

from experiments.run import SCHEMES, Run

_LEVEL = 0.05
_FEWEST_SEEDS = 5  # whose range is an interval of 94 %


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval.

    Attributes:
        value: The number; NaN if what it is of is missing.
        low, high: Ends of the interval; NaN where too little is known for one.
        n: Number of the seeds, samplings or simulations that the interval is over, if known.
        of: What it is over; empty for what is known exactly.
    """

    value: float
    low: float
    high: float
    n: int | None = None
    of: str = ""

    def in_unit(self, unit: float) -> Estimate:
        """The same number in multiples of a unit."""
        ends = (self.value / unit, self.low / unit, self.high / unit)
        return Estimate(*ends, self.n, self.of)


NOT_KNOWN = Estimate(np.nan, np.nan, np.nan)


def point(value: float) -> Estimate:
    """Known exactly, or so well that its interval does not matter."""
    return Estimate(float(value), float(value), float(value))


def over_seeds(values: np.ndarray) -> Estimate:
    """Median, with the interval that the ranks of the values give whatever their distribution."""
    ordered, n = np.sort(values), len(values)
    k = max(int(binom.ppf(_LEVEL / 2, n, 0.5)), 1)
    low, high = (ordered[k - 1], ordered[-k]) if n >= _FEWEST_SEEDS else (np.nan, np.nan)
    return Estimate(float(np.median(values)), low, high, n, "seeds")


def share_below(values: np.ndarray, bound: np.ndarray | float) -> Estimate:
    """Share of the seeds whose value is below a bound."""
    if np.isnan(values - bound).any():
        return NOT_KNOWN
    return _rate(np.sum(values < bound), len(values), "seeds")


def spread_of_seeds(values: np.ndarray) -> Estimate:
    """Standard deviation, with the interval for a normal distribution."""
    free = len(values) - 1
    if free < 1:
        return NOT_KNOWN
    ends = np.sqrt(free / chi2.ppf([1 - _LEVEL / 2, _LEVEL / 2], free))
    sd = np.std(values, ddof=1)
    return Estimate(sd, *(sd * ends), len(values), "seeds")


def over_samplings(values: np.ndarray) -> Estimate:
    """Mean and range of samplings of one test set: of one training."""
    return Estimate(values.mean(), values.min(), values.max(), len(values), "samplings of faces")


def over_faces(value: float, standard_error: float) -> Estimate:
    """Of the faces of one training."""
    half = 1.96 * standard_error
    return Estimate(value, value - half, value + half, None, "faces")


def _rate(count: float, n: int, of: str) -> Estimate:
    test = binomtest(int(count), n)
    return Estimate(count / n, *test.proportion_ci(), n, of)


def holm(ratios: Mapping[str, np.ndarray]) -> dict[str, Estimate]:
    """Geometric means of ratios over seeds, with intervals that decide as Holm's tests do.

    Paired t-tests of the logarithms are taken from the smallest p-value on, each at the level
    divided by the number of those left, until one does not reject: all later ones keep its level.
    """
    if any(len(values) < 2 for values in ratios.values()):
        return dict.fromkeys(ratios, NOT_KNOWN)
    tests = {name: ttest_1samp(np.log(values), 0) for name, values in ratios.items()}
    estimates, level, rejected = {}, _LEVEL, True
    for place, name in enumerate(sorted(tests, key=lambda name: tests[name].pvalue)):
        level = _LEVEL / (len(tests) - place) if rejected else level
        rejected = rejected and tests[name].pvalue < level
        ends = np.exp([*tests[name].confidence_interval(1 - level)])
        mean = np.exp(np.log(ratios[name]).mean())
        estimates[name] = Estimate(mean, *ends, len(ratios[name]), "seeds, Holm")
    return {name: estimates[name] for name in ratios}


class Tables:
    """Tables of results on one face model. What is not there is NaN.

    Args:
        run: Of the BFM track.
    """

    def __init__(self, run: Run):
        self.run = run
        self._tables: dict[Path, pd.DataFrame] = {}

    def table(self, experiment: str, name: str = "metrics") -> pd.DataFrame:
        """A table in `results/<model>/<experiment>`; empty if it is not there."""
        track = experiment.split("-")[0]
        run = self.run.on(track if track in SCHEMES else "bfm")
        path = run.experiment_results(experiment) / f"{name}.csv"
        if path not in self._tables:
            self._tables[path] = pd.read_csv(path) if path.exists() else pd.DataFrame()
        return self._tables[path]

    def samplings(self, method: str, experiment: str = "bfm", metric: str = "mse") -> np.ndarray:
        """A method's means over random samplings of the test faces."""
        return values(self.table(experiment), method=method, metric=metric)

    def error(self, method: str) -> float:
        """A method's MSE on the BFM."""
        return float(self.samplings(method).mean())

    def ours_over(self, method: str, experiment: str) -> Estimate:
        """Ratio of the MSEs of ours and another method on the same samplings."""
        ours, other = (self.samplings(m, experiment) for m in ("ours", method))
        return over_samplings(ours / other)

    def seeds(self, method: str, metric: str = "mse") -> np.ndarray:
        """A method's means over all test faces, from each seed."""
        return values(self.table("seeds"), method=method, metric=metric)

    def variant(self, variant: str, metric: str) -> np.ndarray:
        """Of a variant of the ablation, from each seed."""
        table, n = self.table("ablation"), self.run.preset.train_faces
        return values(table, variant=variant, metric=metric, faces=n)

    def ratio(self, variant: str, other: str, metric: str = "mse") -> np.ndarray:
        """Of one variant to another, from each seed."""
        return self.variant(variant, metric) / self.variant(other, metric)

    def curve(self, sweep: str, value: float, method: str) -> Estimate:
        """A point of the audit's curves."""
        table = self.table("audit", "curves")
        where = {"sweep": sweep, "value": value, "method": method}
        return over_faces(*(values(table, column, **where)[0] for column in ("mse", "sem")))

    def measured(self, topic: str, of: str, **where) -> Estimate:
        """One number of a topic of the audit."""
        return point(values(self.table("audit", topic), of, **where)[0])

    def recovered(self, method: str) -> Estimate:
        """Slope of a method's offsets from the mean shape on the true ones."""
        slope, se = (self.measured("bias", of, method=method) for of in ("slope", "slope_se"))
        return over_faces(slope.value, se.value)

    def false_positives(self, samplings: object) -> Estimate:
        """Rate at which a test takes methods for different that only chance tells apart."""
        of, where = ("rate", "simulations"), {"samplings": str(samplings)}
        rate, n = (self.measured("samplings", column, **where).value for column in of)
        return NOT_KNOWN if np.isnan(rate) else _rate(round(rate * n), int(n), "simulations")


def values(table: pd.DataFrame, of: str = "value", /, **where) -> np.ndarray:
    """A column of the rows that have these values in other columns; one NaN if there are none."""
    if table.empty:
        return np.array([np.nan])
    for column, wanted in where.items():
        table = table[table[column] == wanted]
    return table[of].to_numpy() if len(table) else np.array([np.nan])
