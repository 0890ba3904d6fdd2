"""Checks on the criteria: what answers without depth score, and what the printed numbers mean."""

from types import SimpleNamespace

import numpy as np
import pytest

from data_gen.datasets.dataset import make_dataset
from data_gen.models.openhead import load_openhead
from deepmds_keras.normalisation import normalise
from experiments.audit import criteria
from experiments.audit.claims import judge, load_claims
from experiments.scoring.scores import score
from experiments.verdicts import DOES_NOT_HOLD, HOLDS, UNKNOWN, WITH_CONDITION

CLAIMS = load_claims()
N_FACES = 60


@pytest.fixture(scope="module")
def inputs():
    rng = np.random.default_rng(0)
    model = load_openhead()
    truth = normalise(make_dataset(model, N_FACES, rng).landmarks)
    test = SimpleNamespace(shapes=truth, unit_mm=np.full(N_FACES, 207.0))
    shapes = {
        "mean_shape": np.broadcast_to(truth.mean(0), truth.shape),
        "ours": truth + 0.01 * rng.standard_normal(truth.shape),
        "linear": truth + 0.001 * rng.standard_normal(truth.shape),
    }
    return SimpleNamespace(
        run=SimpleNamespace(seed=0),
        model=model,
        test=test,
        audited=np.arange(0, N_FACES, 2),
        predictions=shapes,
        scores={method: score(own, test) for method, own in shapes.items()},
    )


@pytest.fixture(scope="module")
def measured(inputs):
    return criteria.measure(inputs)


def judged(claim, check, measured, **changed):
    return judge(CLAIMS[claim], check, {**measured, **changed})


def test_readings_of_the_formula_for_known_differences():
    truth = np.zeros((2, 4, 3))
    readings = criteria.mse_readings(truth + (0.3, 0.0, -0.4), truth)
    assert readings["sum_of_coordinates"] == pytest.approx(4 * 0.7)
    assert readings["sum_of_distances"] == pytest.approx(4 * 0.5)
    assert readings["mean_of_coordinates"] == pytest.approx(0.7)
    assert readings["mean_of_distances"] == pytest.approx(0.5)
    assert readings["mean_of_squares"] == pytest.approx(0.25 / 3)
    assert readings["root_mean_square"] == pytest.approx((0.25 / 3) ** 0.5)


def test_only_the_mean_of_squares_has_the_printed_size(measured):
    finding = judged("mse-formula", criteria.mse_formula, measured)
    assert finding.verdict == DOES_NOT_HOLD
    # Noise of s.d. 0.01, less the few degrees of freedom of the alignment.
    assert 0.9e-4 < measured["mse_readings"]["mean_of_squares"] < 1e-4
    assert "the paper prints 0.00014" in finding.evidence


@pytest.mark.parametrize(
    ("reading", "verdict"),
    [("sum_of_coordinates", HOLDS), ("sum_of_distances", HOLDS),
     ("mean_of_distances", WITH_CONDITION), ("root_mean_square", UNKNOWN)],
)  # fmt: skip
def test_a_printed_number_of_another_reading_is_taken_for_that(measured, reading, verdict):
    # Far from each other, as sums, means and squares of small numbers are.
    readings = dict.fromkeys(measured["mse_readings"], 1e-9) | {reading: 2e-4}
    finding = judged("mse-formula", criteria.mse_formula, measured, mse_readings=readings)
    assert finding.verdict == verdict


def test_answers_without_depth_keep_most_of_the_depth_correlation(measured):
    finding = judged("depth-corr-meaning", criteria.depth_corr_meaning, measured)
    assert finding.verdict == DOES_NOT_HOLD
    own, centred = measured["depth_corr"], measured["depth_corr_centred"]
    assert own["truth"] == pytest.approx(72)
    assert own["inverted"] == pytest.approx(72)  # reflection makes it the truth
    assert own["point"] < own["cloud"] < own["inverted_unreflected"] < own["flat"] < 72
    assert own["cloud"] > 0.9 * 72
    assert centred["cloud"] < 0.3 * 72
    assert centred["point"] == pytest.approx(0, abs=1)
    assert f"{100 * own['flat'] / 72:.4g} % by a face without depth" in finding.evidence


def test_the_criterion_across_faces_passes_the_same_check(measured):
    finding = judged(
        "depth-corr-meaning", criteria.depth_corr_meaning, measured,
        depth_corr=measured["across_faces"],
    )  # fmt: skip
    assert finding.verdict == HOLDS


def test_a_criterion_that_only_its_origin_spoils_passes_with_a_condition(measured):
    sensible = {**measured["depth_corr_centred"], "flat": 40.0, "cloud": 10.0}
    finding = judged(
        "depth-corr-meaning", criteria.depth_corr_meaning, measured, depth_corr_centred=sensible
    )
    assert finding.verdict == WITH_CONDITION
    assert "mean of the landmarks" in finding.condition


def test_methods_are_ranked_by_both(inputs):
    assert criteria.rank_correlation(inputs.scores, inputs.test.shapes) == pytest.approx(1)
    truth = inputs.test.shapes
    upside_down = {
        method: SimpleNamespace(aligned=truth + error, depth_corr=np.full(N_FACES, 70.0 + error))
        for method, error in (("a", 0.1), ("b", 0.2), ("c", 0.3))
    }
    assert criteria.rank_correlation(upside_down, truth) == pytest.approx(-1)


def test_the_maximum_is_the_number_of_landmarks_not_100(measured):
    finding = judged("depth-corr-percent", criteria.depth_corr_percent, measured)
    assert finding.verdict == DOES_NOT_HOLD
    assert "scores 72. The printed 71.42 to 71.99 are 99.19 % to 99.99 %" in finding.evidence
    percentages = {**measured["depth_corr"], "truth": 100.0}
    other = judged(
        "depth-corr-percent", criteria.depth_corr_percent, measured, depth_corr=percentages
    )
    assert other.verdict == HOLDS


def test_no_reading_explains_the_correlations_on_casia(measured):
    finding = judged("casia-depth-corr", criteria.casia_depth_corr, measured)
    assert finding.verdict == DOES_NOT_HOLD
    assert "The maximum on 51 landmarks is 51" in finding.evidence
    of_51 = measured["on_casia"]["model"]["51"]
    assert of_51["truth"] == pytest.approx(51)
    # More noise, of a larger printed MSE, keeps less.
    assert of_51["cloud"] < of_51["zhao"] < of_51["ours"] < of_51["mediapipe"] < 51
    assert measured["on_casia"]["landmarks"]["51"]["cloud"] < of_51["cloud"] / 2


def test_correlations_below_the_maximum_would_be_possible(measured):
    possible = {"zhao": 48.0, "ours": 50.0}
    finding = judged(
        "casia-depth-corr", criteria.casia_depth_corr, measured, printed_on_casia=possible
    )
    assert finding.verdict == HOLDS
    assert "50 (Deep-MDS)" in finding.evidence


@pytest.mark.parametrize(
    ("reading", "scale"), [("sums over 68", 1), ("percentages of the maximum", 100 / 51)]
)
def test_a_reading_that_explains_them_is_a_condition(measured, reading, scale):
    n = "68" if scale == 1 else "51"
    of_noise = measured["on_casia"]["landmarks"][n]
    fitting = {method: scale * of_noise[method] + 0.2 for method in ("zhao", "mediapipe")}
    finding = judged(
        "casia-depth-corr", criteria.casia_depth_corr, measured, printed_on_casia=fitting
    )
    assert finding.verdict == WITH_CONDITION
    assert reading in finding.condition


def test_a_model_without_those_landmarks_leaves_it_open(measured):
    model = SimpleNamespace(landmarks={"bfm72": np.arange(72)})
    assert criteria.of_noise(model, {}, 5, np.random.default_rng(0)) is None
    finding = judged("casia-depth-corr", criteria.casia_depth_corr, measured, on_casia=None)
    assert finding.verdict == UNKNOWN
