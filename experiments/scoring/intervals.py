"""Numbers with their 95 % intervals: over seeds, samplings, faces or simulations."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import binom, binomtest, chi2, ttest_1samp

LEVEL = 0.05  # of significance
ONE_TRAINING = ("samplings of faces", "faces")  # what is counted where another seed may differ
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


def sd_of_seeds(values: np.ndarray) -> Estimate:
    """Standard deviation, with the interval for a normal distribution."""
    free = len(values) - 1
    if free < 1:
        return NOT_KNOWN
    ends = np.sqrt(free / chi2.ppf([1 - LEVEL / 2, LEVEL / 2], free))
    sd = np.std(values, ddof=1)
    return Estimate(sd, *(sd * ends), len(values), "seeds")


def over_samplings(values: np.ndarray) -> Estimate:
    """Mean and range over samplings of one test set, for one training."""
    return Estimate(values.mean(), values.min(), values.max(), len(values), ONE_TRAINING[0])


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
    p_values, estimates = np.array([test.pvalue for test in tests.values()]), {}
    n_rejected = (holm_adjusted(p_values) < LEVEL).sum()
    for place, name in enumerate(sorted(tests, key=lambda name: tests[name].pvalue)):
        level = LEVEL / (len(tests) - min(place, n_rejected))
        ends = np.exp([*tests[name].confidence_interval(1 - level)])
        mean = np.exp(np.log(ratios[name]).mean())
        estimates[name] = Estimate(mean, *ends, len(ratios[name]), "seeds, Holm")
    return {name: estimates[name] for name in ratios}


def holm_adjusted(p_values: np.ndarray) -> np.ndarray:
    """p-values `(n,)` corrected for their number, after Holm 1979 (jstor.org/stable/4615733)."""
    order, n = np.argsort(p_values), len(p_values)
    steps = (n - np.arange(n)) * np.asarray(p_values)[order]
    return np.maximum.accumulate(steps).clip(max=1)[np.argsort(order)]
