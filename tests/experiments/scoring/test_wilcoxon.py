"""Wilcoxon's test of every two methods, against SciPy's and the textbook's."""

import numpy as np
import pytest
from scipy.stats import norm, wilcoxon

from deepmds_keras import InputError
from experiments.scoring.wilcoxon import wilcoxon_table


def test_every_two_methods_are_compared_once_as_by_scipy():
    values = dict(zip("abcd", np.random.default_rng(0).standard_normal((4, 30)), strict=True))
    table = wilcoxon_table(values)
    assert [*(table["method_a"] + table["method_b"])] == ["ab", "ac", "ad", "bc", "bd", "cd"]
    expected = wilcoxon(values["b"], values["d"])
    row = table.iloc[4]
    assert (row["statistic"], row["p_value"]) == (expected.statistic, expected.pvalue)
    assert row["median_difference"] == np.median(values["b"] - values["d"])


def test_the_normal_approximation_allows_for_ties_and_zeros():
    row = wilcoxon_table({"a": np.array([0, 1, 1, 1, -2, 3, 3.0]), "b": np.zeros(7)}).iloc[0]
    n, rank_sum, ties = 6, 4, (3**3 - 3) + (2**3 - 2)
    variance = n * (n + 1) * (2 * n + 1) / 24 - ties / 48
    z = (rank_sum - n * (n + 1) / 4) / np.sqrt(variance)
    assert row["p_value_normal"] == pytest.approx(2 * norm.cdf(z))
    same = wilcoxon_table({"a": np.ones(10), "b": np.ones(10)}).iloc[0]
    assert (same["p_value"], same["p_value_normal"], same["median_difference"]) == (1, 1, 0)


def test_values_that_cannot_be_compared_are_named():
    with pytest.raises(InputError, match=r"values of a must be a row of finite numbers"):
        wilcoxon_table({"a": np.ones((3, 2)), "b": np.ones(3)})
