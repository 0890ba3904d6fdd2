"""Claims on who is better than whom: each check gives the other verdict where it is false."""

import pytest

from experiments.audit import not_testable, ranking
from experiments.verdicts import DOES_NOT_HOLD, HOLDS, UNKNOWN, WITH_CONDITION

PAPER = {"mobileface": 0.6e-4, "ours": 1.4e-4, "aldrian": 2.5e-4, "zhao": 22e-4, "linear": 1e-6}
PRINTED = {"printed_mse": 1.4e-4, "printed_depth_corr": 71.95}


@pytest.mark.parametrize(
    ("model", "mse", "verdict"),
    [
        ("bfm2009", 1.5e-4, HOLDS),
        ("bfm2009", 3e-4, DOES_NOT_HOLD),
        ("bfm2009", 0.5e-4, DOES_NOT_HOLD),
        ("ict", 1.4e-4, UNKNOWN),
    ],
)
def test_the_printed_error_is_that_of_the_basel_model_alone(model, mse, verdict):
    found = ranking.as_printed(model, {"ours": mse}, 71.9, **PRINTED)
    assert found.verdict == verdict
    assert f"{mse / 1e-4:.3g} × 10⁻⁴" in found.evidence


def test_a_constant_solution_is_beaten_or_not_or_one_of_them():
    def beats(mean_shape, random_face):
        constants = {"mean shape": mean_shape, "one random training face": random_face}
        means = PAPER | {"mean_shape": mean_shape}
        errors = {"ours": PAPER["ours"], **constants}
        return ranking.beats_constant(means, errors, by_seed, 2.9e-4)

    by_seed = None

    assert beats(2.9e-4, 6e-4).verdict == HOLDS
    found = beats(0.6e-4, 2e-4)
    assert found.verdict == WITH_CONDITION
    assert found.condition == "if the constant solution is one random training face"
    found = beats(0.6e-4, 1.2e-4)
    assert found.verdict == DOES_NOT_HOLD
    assert "Methods that err less than the mean shape on all faces: Linear." in found.evidence
    by_seed = {"ours": [1e-4, 0.5e-4, 2e-4], "mean_shape": [0.6e-4, 0.62e-4, 0.61e-4]}
    found = beats(0.6e-4, 1.2e-4)
    assert "From 3 seeds Deep-MDS has 1.0 [0.5, 2.0] (median and range)" in found.evidence
    assert found.evidence.endswith("it beats the mean shape from 1.")


def test_second_place_is_behind_mobileface_alone():
    assert ranking.second(PAPER, None).verdict == HOLDS
    assert ranking.second(PAPER | {"aldrian": 1e-5}, None).verdict == DOES_NOT_HOLD
    assert ranking.second(PAPER | {"mobileface": 9e-4}, None).verdict == DOES_NOT_HOLD
    without = {m: e for m, e in PAPER.items() if m != "mobileface"}
    assert ranking.second(without, None).verdict == UNKNOWN


def test_the_released_evaluator_may_decide_on_zhao():
    better = PAPER | {"zhao": 1e-5}
    assert ranking.second(better, {"zhao": 22e-4}).verdict == WITH_CONDITION
    assert ranking.second(better, None).verdict == DOES_NOT_HOLD


def test_the_authors_fit_of_aldrian_may_decide_on_second_place():
    better = PAPER | {"aldrian": 1e-5}
    found = ranking.second(better | {"aldrian_authors": 1.5e-4}, None)
    assert found.verdict == WITH_CONDITION and "scaled coefficients" in found.condition
    assert ranking.second(better | {"aldrian_authors": 1.3e-4}, None).verdict == DOES_NOT_HOLD
    both = better | {"zhao": 1e-5, "aldrian_authors": 1.5e-4}
    found = ranking.second(both, {"zhao": 22e-4})
    assert "released evaluator" in found.condition and "scaled coefficients" in found.condition
    assert ranking.second(both, None).verdict == DOES_NOT_HOLD
    none = PAPER | {"aldrian_authors": 1.3e-4}
    assert ranking.second(none, None).verdict == HOLDS, "what nobody asks for changes nothing"


def test_on_photos_the_authors_fit_of_aldrian_is_asked_where_ours_is_better():
    def beats(ours, aldrian, authors):
        means = photos(ours, aldrian) | {"aldrian_authors": authors}
        return ranking.celeba_beats_aldrian(means, means)

    assert beats(1e-6, 2e-6, 2e-6).verdict == HOLDS
    found = beats(3e-6, 2e-6, 4e-6)
    assert found.verdict == WITH_CONDITION and "scaled coefficients" in found.condition
    assert "authors' fit 0.4" in found.evidence
    assert beats(3e-6, 2e-6, 2e-6).verdict == DOES_NOT_HOLD


def photos(ours, other, method="aldrian"):
    return {"ours": ours, method: other, "mean_shape": 1e-5}


def test_on_photos_both_truths_are_asked():
    good, bad = photos(1e-6, 2e-6), photos(3e-6, 2e-6)
    assert ranking.celeba_beats_aldrian(good, good).verdict == HOLDS
    assert ranking.celeba_beats_aldrian(bad, bad).verdict == DOES_NOT_HOLD
    found = ranking.celeba_beats_aldrian(bad, good)
    assert found.verdict == WITH_CONDITION
    assert "true landmarks" in found.condition
    assert ranking.celeba_beats_aldrian(good, None).verdict == HOLDS
    assert ranking.celeba_beats_aldrian(None, None).verdict == UNKNOWN


def test_comparable_with_mobileface_is_within_a_factor():
    alike, worse = photos(1.4e-6, 1e-6, "mobileface"), photos(1.6e-6, 1e-6, "mobileface")
    assert ranking.celeba_like_mobileface(alike, alike).verdict == HOLDS
    assert ranking.celeba_like_mobileface(worse, worse).verdict == DOES_NOT_HOLD
    assert ranking.celeba_like_mobileface(photos(1, 1), None).verdict == UNKNOWN


def test_on_scans_mediapipe_and_ringnet_both_count():
    both = {"ours": 1.5e-3, "mediapipe": 1.3e-3, "ringnet": 1.34e-3, "mean_shape": 3e-4}
    assert ranking.casia_like_others(both, None).verdict == HOLDS
    assert ranking.casia_like_others(both | {"ours": 9e-3}, None).verdict == DOES_NOT_HOLD
    found = ranking.casia_like_others(both | {"ringnet": 3e-4}, None)
    assert (found.verdict, found.condition) == (WITH_CONDITION, "with MediaPipe")
    without = {m: e for m, e in both.items() if m != "ringnet"}
    assert "RingNet was not run" in ranking.casia_like_others(without, without).condition
    assert ranking.casia_like_others(None, None).verdict == UNKNOWN
    assert ranking.casia_like_others({"ours": 1e-3, "ringnet": 1}, None).verdict == UNKNOWN


@pytest.mark.parametrize(
    ("model", "triangles", "verdict"),
    [("bfm2009", 160_470, HOLDS), ("bfm2009", 106_466, DOES_NOT_HOLD), ("ict", 160_470, UNKNOWN)],
)
def test_triangles_are_counted_on_the_basel_model_alone(model, triangles, verdict):
    found = not_testable.triangles(model, 53_490, triangles, 53_490.0, 160_470.0)
    assert found.verdict == verdict
    assert "160,470 is 3 times the 53,490 vertices" in found.evidence


def test_the_literature_is_not_computed():
    assert not_testable.first_use().verdict == UNKNOWN
