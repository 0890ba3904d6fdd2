"""Numbers with intervals, from the tables of results on one face model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import binom, binomtest, chi2, ttest_1samp

from experiments.run import SCHEMES, Run

LEVEL = 0.05  # of significance
_FEWEST_SEEDS = 5  # the range of five is an interval of 94 %


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval.

    Attributes:
        value: The number; NaN if its data are missing.
        low, high: Ends of the interval; NaN if the data are too few for one.
        n: Number of seeds, samplings or simulations behind the interval, if known.
        of: What `n` counts; empty for an exact number.
    """

    value: float
    low: float
    high: float
    n: int | None = None
    of: str = ""


NOT_KNOWN = Estimate(np.nan, np.nan, np.nan)


def point(value: float) -> Estimate:
    """An exact number, or one whose interval is negligible."""
    return Estimate(float(value), float(value), float(value))


def over_seeds(values: np.ndarray) -> Estimate:
    """Median, with the distribution-free interval from the ranks of the values."""
    ordered, n = np.sort(values), len(values)
    k = max(int(binom.ppf(LEVEL / 2, n, 0.5)), 1)
    low, high = (ordered[k - 1], ordered[-k]) if n >= _FEWEST_SEEDS else (np.nan, np.nan)
    return Estimate(float(np.median(values)), low, high, n, "seeds")


def share_below(values: np.ndarray, bound: np.ndarray | float) -> Estimate:
    """Share of the seeds whose value is below a bound."""
    below = np.where(np.isnan(values - bound), np.nan, values < bound)
    return rate(below.mean(), len(values), "seeds")


def spread_of_seeds(values: np.ndarray) -> Estimate:
    """Standard deviation, with the interval for a normal distribution."""
    free = len(values) - 1
    if free < 1:
        return NOT_KNOWN
    ends = np.sqrt(free / chi2.ppf([1 - LEVEL / 2, LEVEL / 2], free))
    sd = np.std(values, ddof=1)
    return Estimate(sd, *(sd * ends), len(values), "seeds")


def over_samplings(values: np.ndarray) -> Estimate:
    """Mean and range over samplings of one test set, for one training."""
    return Estimate(values.mean(), values.min(), values.max(), len(values), "samplings of faces")


def rate(share: float, n: float, of: str) -> Estimate:
    """Share of n cases, with the exact interval of the binomial distribution."""
    if np.isnan(share):
        return NOT_KNOWN
    test = binomtest(round(share * n), int(n))
    return Estimate(test.statistic, *test.proportion_ci(), test.n, of)


def holm(ratios: Mapping[str, np.ndarray]) -> dict[str, Estimate]:
    """Geometric means of ratios over seeds, with intervals that agree with Holm's tests.

    Paired t-tests of the logarithms are taken in order of p-value, each at the level divided by
    the number of those left, until one does not reject: all later ones keep its level.
    """
    if any(len(values) < 2 for values in ratios.values()):
        return dict.fromkeys(ratios, NOT_KNOWN)
    tests = {name: ttest_1samp(np.log(values), 0) for name, values in ratios.items()}
    estimates, level, rejected = {}, LEVEL, True
    for place, name in enumerate(sorted(tests, key=lambda name: tests[name].pvalue)):
        level = LEVEL / (len(tests) - place) if rejected else level
        rejected = rejected and tests[name].pvalue < level
        ends = np.exp([*tests[name].confidence_interval(1 - level)])
        mean = np.exp(np.log(ratios[name]).mean())
        estimates[name] = Estimate(mean, *ends, len(ratios[name]), "seeds, Holm")
    return {name: estimates[name] for name in ratios}


@dataclass(frozen=True)
class Tables:
    """Tables of results on one face model, for a run of the BFM track. Missing numbers are NaN."""

    run: Run

    def values(self, experiment: str, name: str, of: str, **where) -> np.ndarray:
        """A column of a table in `results/<model>/<experiment>`; one NaN if it has no such row.

        Args:
            where: What other columns hold in the rows: a value, or several to choose from.
        """
        track = experiment.split("-")[0]
        run = self.run.on(track if track in SCHEMES else "bfm")
        path = run.experiment_results(experiment) / f"{name}.csv"
        if not path.exists():
            return np.array([np.nan])
        table = pd.read_csv(path)
        for column, wanted in where.items():
            table = table[table[column].isin(np.atleast_1d(wanted))]
        return table[of].to_numpy() if len(table) else np.array([np.nan])

    def samplings(self, method: str, experiment: str = "bfm", metric: str = "mse") -> np.ndarray:
        """A method's means over random samplings of the test faces."""
        return self.values(experiment, "metrics", "value", method=method, metric=metric)

    def error(self, method: str) -> float:
        """A method's MSE on the BFM."""
        return float(self.samplings(method).mean())

    def seeds(self, method: str, metric: str = "mse") -> np.ndarray:
        """A method's means over all test faces, from each seed."""
        return self.samplings(method, "seeds", metric)

    def variant(self, variant: str, metric: str = "mse") -> np.ndarray:
        """A metric of a variant of the ablation, from each seed."""
        where = {"variant": variant, "metric": metric, "faces": self.run.preset.train_faces}
        return self.values("ablation", "metrics", "value", **where)

    def measured(self, topic: str, of: str, **where) -> Estimate:
        """One number of a topic of the audit."""
        return point(self.values("audit", topic, of, **where)[0])

    def over_faces(self, topic: str, of: str, standard_error: str, **where) -> Estimate:
        """One number of a topic, with the interval of its standard error over faces."""
        names = (of, standard_error)
        value, error = (self.measured(topic, name, **where).value for name in names)
        return Estimate(value, value - 1.96 * error, value + 1.96 * error, None, "faces")
