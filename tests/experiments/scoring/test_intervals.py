"""Intervals cover the truth as often as they promise, and Holm's decide as his tests."""

import math

import numpy as np
import pytest
from scipy.stats import binom, ttest_rel

from experiments.scoring.intervals import holm, over_seeds, sd_of_seeds, share_below


def coverage(estimates, truth):
    return np.mean([e.low <= truth <= e.high for e in estimates])


@pytest.mark.parametrize(("n", "of_median"), [(10, 1 - 2 * binom.cdf(1, 10, 0.5)), (5, 0.9375)])
def test_intervals_over_seeds_cover_the_truth_whatever_the_distribution(rng, n, of_median):
    skewed = rng.exponential(size=(2000, n))
    assert coverage(map(over_seeds, skewed), math.log(2)) == pytest.approx(of_median, abs=0.02)
    normal = rng.standard_normal((2000, n))
    assert coverage(map(sd_of_seeds, normal), 1) == pytest.approx(0.95, abs=0.02)
    covers = [coverage([share_below(np.arange(n), k)], 0.5) for k in range(n + 1)]
    assert np.dot(covers, binom.pmf(range(n + 1), n, 0.5)) >= 0.95


def test_few_seeds_have_no_interval_and_what_is_missing_no_number():
    assert math.isnan(over_seeds(np.array([1.0, 2.0])).high)
    assert math.isnan(sd_of_seeds(np.array([1.0])).value)
    assert math.isnan(holm({"a": np.array([1.0])})["a"].value)
    assert math.isnan(share_below(np.array([1.0, 2.0]), math.nan).value)


def test_holms_intervals_decide_as_his_step_down_tests(rng):
    for _ in range(200):
        ratios = {f"{k}": np.exp(rng.normal(0.2 * k, 0.2, 5)) for k in range(4)}
        p_values = {k: ttest_rel(np.log(r), np.zeros(5)).pvalue for k, r in ratios.items()}
        ordered = sorted(p_values, key=p_values.get)
        rejected = set()
        for place, name in enumerate(ordered):
            if p_values[name] > 0.05 / (4 - place):
                break
            rejected.add(name)
        estimates = holm(ratios)
        assert {k for k, e in estimates.items() if not e.low <= 1 <= e.high} == rejected
        assert [*estimates] == [*ratios]
