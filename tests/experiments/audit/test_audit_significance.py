"""Checks on the p-value and on what samplings of one test set show."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from experiments.audit import significance
from experiments.audit.claims import judge, load_claims
from experiments.verdicts import DOES_NOT_HOLD, HOLDS, WITH_CONDITION

CLAIMS = load_claims()
N_FACES, SAMPLINGS, SIZE = 400, 10, 40


@pytest.fixture(scope="module")
def inputs():
    rng = np.random.default_rng(0)
    faces = rng.gamma(2.0, 1.0, N_FACES)
    sizes = {"zhao": 4, "aldrian": 3, "mobileface": 1, "ours": 2, "ours_stable": 1.9}
    return SimpleNamespace(
        run=SimpleNamespace(seed=0, preset=SimpleNamespace(n_subsets=SAMPLINGS, subset_size=SIZE)),
        scores={
            method: SimpleNamespace(mse=size * faces + 0.1 * rng.gamma(2.0, 1.0, N_FACES))
            for method, size in sizes.items()
        },
    )


@pytest.fixture(scope="module")
def measured(inputs):
    return significance.measure(inputs)


def judged(claim, check, measured, **changed):
    return judge(CLAIMS[claim], check, {**measured, **changed})


def test_the_p_value_of_casia_is_judged_by_the_numbers_of_its_own_table(measured):
    finding = judged("p-value-casia", significance.p_value_of_casia, measured)
    assert finding.verdict == DOES_NOT_HOLD
    assert measured["criteria_casia"] != measured["criteria"]
    assert f"{measured['criteria_casia']['opposite']} of 6 pairs" in finding.evidence


def test_the_least_p_value_is_that_of_all_signs_equal():
    for n in (5, 10, 20):
        least = significance.least_p_value(n)
        assert least["exact"] == pytest.approx(2 / 2**n)
        z = n * (n + 1) / 2 / np.sqrt(n * (n + 1) * (2 * n + 1) / 6)
        assert least["normal"] == pytest.approx(2 * norm.sf(z))


def test_the_printed_p_value_takes_twenty_values(measured):
    finding = judged("p-value", significance.p_value, measured)
    assert finding.verdict == DOES_NOT_HOLD
    assert "0.00195" in finding.evidence
    assert "takes 20 (8.86 × 10⁻⁵, normal approximation)." in finding.evidence
    assert "6 of 6 pairs" in finding.evidence
    twenty = significance.p_value(measured["p_values"], measured["printed_p"], {}, n_subsets=20)
    assert twenty.verdict == HOLDS


def test_a_p_value_that_ten_values_give_holds(measured):
    for printed in (0.0019, 0.0020, 0.0051):
        assert judged("p-value", significance.p_value, measured, printed_p=printed).verdict == HOLDS
    finding = judged("p-value", significance.p_value, measured, printed_p=0.04)
    assert finding.verdict == DOES_NOT_HOLD
    assert "takes another number than 5 to 30" in finding.evidence


def test_criteria_that_agree_on_the_better_method_have_differences_of_opposite_signs():
    agreeing = {"a": [1e-4, 71.9], "b": [2e-4, 71.8], "c": [3e-4, 71.85]}
    found = significance.both_criteria(agreeing, 10)
    assert (found["pairs"], found["opposite"]) == (3, 2)
    z = (155 - 55) / np.sqrt(20 * 21 * 41 / 6)
    assert found["normal"] == pytest.approx(2 * norm.sf(z))


def test_samplings_find_differences_between_exchangeable_methods_and_faces_seldom_do():
    difference = np.random.default_rng(1).standard_normal(1000)
    rates = significance.false_positives(
        difference, [10, 50], 100, 0.05, np.random.default_rng(2), simulations=300
    )
    # The luck of the test set has 1/9 of the variance of a sampling's mean, and every sampling has
    # it: the test over 10 of them sees a variance of 1 + 10/9 times the one that it reckons with.
    assert rates["10"] == pytest.approx(2 * norm.sf(1.96 / (1 + 10 / 9) ** 0.5), abs=0.06)
    assert rates["50"] > rates["10"] + 0.1
    assert rates["faces"] < 0.09


def test_samplings_of_a_test_set_without_end_would_keep_to_the_level():
    difference = np.random.default_rng(1).standard_normal(20_000)
    rates = significance.false_positives(
        difference, [10], 100, 0.05, np.random.default_rng(2), simulations=200
    )
    assert rates["10"] < 0.1


def test_samplings_are_condemned_and_the_conclusion_is_kept(measured):
    finding = judged("significance", significance.samplings, measured)
    assert finding.verdict == WITH_CONDITION
    rate = measured["false_positives"][str(SAMPLINGS)]
    assert f"at 5 % in {100 * rate:.2g} % of the cases" in finding.evidence
    assert f"{SAMPLINGS} samplings of {SIZE} of {N_FACES} faces" in finding.evidence
    assert "all 6 pairs" in finding.evidence


def test_samplings_that_keep_to_the_level_hold(measured):
    honest = {"10": 0.06, "20": 0.05, "50": 0.05, "faces": 0.05}
    finding = judged("significance", significance.samplings, measured, false_positives=honest)
    assert finding.verdict == HOLDS
    assert "in 6 % of the cases" in finding.evidence


def test_methods_that_do_not_differ_leave_nothing_of_the_claim(inputs, measured):
    rng = np.random.default_rng(3)
    alike = {
        method: own.mse + rng.standard_normal(N_FACES) for method, own in inputs.scores.items()
    }
    alike["aldrian"] = alike["ours"] + rng.standard_normal(N_FACES)
    pairs = significance.over_faces({m: alike[m] for m in ("aldrian", "ours", "zhao")}, 0.05)
    assert (pairs["n"], pairs["differ"]) == (3, 2)
    finding = judged("significance", significance.samplings, measured, pairs=pairs)
    assert finding.verdict == DOES_NOT_HOLD
    assert "2 of 3 pairs" in finding.evidence
