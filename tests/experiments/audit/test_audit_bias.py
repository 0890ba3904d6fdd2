"""The bias towards the mean shape: its measure on predictions made to be biased, and verdicts."""

from types import SimpleNamespace

import numpy as np
import pytest

from deepmds_keras.alignment import align
from experiments.audit import bias
from experiments.verdicts import DOES_NOT_HOLD, HOLDS, WITH_CONDITION

N, L = 400, 30


def faces(rng, n=N):
    """A mean shape, and faces that differ from it in 12 ways."""
    mean = rng.uniform(0, 1, (L, 3))
    ways = rng.normal(0, 0.01, (12, L, 3))
    return mean, mean + np.tensordot(rng.standard_normal((n, 12)), ways, 1)


def measured(predicted, mean, truth):
    """As predictions are scored: each aligned to its truth."""
    return bias.bias_of(
        align(predicted, truth), align(np.broadcast_to(mean, truth.shape), truth), truth
    )


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.mark.parametrize("part", [0.25, 0.9, 1.3])
def test_slope_is_the_part_of_the_offset_that_is_found_again(rng, part):
    mean, truth = faces(rng)
    found = measured(mean + part * (truth - mean), mean, truth)
    assert found["slope"] == pytest.approx(part, abs=0.01)
    assert found["cosine"] == pytest.approx(np.sign(1 - part), abs=0.05)
    assert found["correlation"] > 0.99


def test_mean_shape_has_none_of_the_offset(rng):
    mean, truth = faces(rng)
    found = measured(np.broadcast_to(mean, truth.shape), mean, truth)
    assert found["slope"] == found["correlation"] == 0
    assert found["cosine"] == pytest.approx(1)


def test_truth_is_unbiased(rng):
    mean, truth = faces(rng)
    found = bias.bias_of(truth, align(np.broadcast_to(mean, truth.shape), truth), truth)
    assert found["slope"] == pytest.approx(1)
    assert found["correlation"] == pytest.approx(1)
    assert found["cosine"] == found["systematic_share"] == 0


def test_noise_as_large_as_the_offsets_is_no_bias(rng):
    mean, truth = faces(rng)
    noise = rng.normal(0, 0.035, truth.shape)  # as large as the offsets
    found = measured(truth + noise, mean, truth)
    assert found["slope"] == pytest.approx(1, abs=0.03)
    assert abs(found["cosine"]) < 0.05
    assert found["systematic_share"] < 0.02
    assert found["correlation"] < 0.8
    # Nor does it hide one.
    assert measured(mean + noise, mean, truth)["slope"] == pytest.approx(0, abs=0.05)


def test_same_error_in_every_face_is_systematic_and_not_towards_the_mean(rng):
    mean, truth = faces(rng)
    found = measured(truth + rng.normal(0, 0.03, (L, 3)), mean, truth)
    assert found["slope"] == pytest.approx(1, abs=0.02)
    assert abs(found["cosine"]) < 0.1
    assert found["systematic_share"] > 0.8


def test_standard_error_is_the_spread_over_samples_of_faces(rng):
    mean, truth = faces(rng, 40 * 60)
    predicted = truth + rng.normal(0, 0.05, truth.shape)
    samples = [measured(predicted[i::40], mean, truth[i::40]) for i in range(40)]
    spread = np.std([own["slope"] for own in samples], ddof=1)
    assert np.mean([own["slope_se"] for own in samples]) == pytest.approx(spread, rel=0.35)


def test_measures_the_methods_that_were_run(rng):
    mean, truth = faces(rng, 50)
    predicted = {
        "mean_shape": np.broadcast_to(mean, truth.shape),
        "ours": mean + 0.5 * (truth - mean),
        "zhao_frontal": truth,
    }
    scores = {m: SimpleNamespace(aligned=align(own, truth)) for m, own in predicted.items()}
    found = bias.measure(SimpleNamespace(test=SimpleNamespace(shapes=truth), scores=scores))
    assert [*found["bias"]] == ["mean_shape", "ours"]  # the frontal one sees other views
    assert found["bias"]["ours"]["slope"] == pytest.approx(0.5, abs=0.01)
    assert found["n_faces"] == 50


def numbers(slopes, systematic=0.4):
    return {
        method: {
            "slope": slope,
            "slope_se": 0.001,
            "cosine": 0.321,
            "systematic_share": systematic,
            "correlation": 0.654,
        }
        for method, slope in ({"linear": 0.9, "ours_stable": 0.2} | slopes).items()
    }


@pytest.mark.parametrize(
    ("ours", "systematic", "verdict", "condition"),
    [
        (0.97, 0.4, HOLDS, ""),
        (1.05, 0.4, HOLDS, ""),
        (0.8, 0.4, WITH_CONDITION, "compared with Aldrian & Smith and MobileFace"),
        (0.65, 0.4, WITH_CONDITION, "compared with MobileFace"),
        (0.2, 0.05, WITH_CONDITION, "unbiased means that errors average out over faces"),
        (0.2, 0.4, DOES_NOT_HOLD, ""),
        (2.5, 0.4, DOES_NOT_HOLD, ""),
    ],
)
def test_unbiased(ours, systematic, verdict, condition):
    measured = numbers({"ours": ours, "aldrian": 0.7, "mobileface": 0.6}, systematic)
    finding = bias.unbiased(measured, 123)
    assert (finding.verdict, finding.condition) == (verdict, condition)
    for number in (f"{ours}", "0.32", "0.65", f"{100 * systematic:.0f} %", "123"):
        assert number in finding.evidence


@pytest.mark.parametrize(("slope", "verdict"), [(0.95, HOLDS), (1.05, HOLDS), (0.8, DOES_NOT_HOLD)])
def test_lifting_is_biased_if_a_part_of_the_offset_is_lost(slope, verdict):
    assert bias.lifting_unbiased(numbers({"lifting": slope, "ours": 0.3}), 5).verdict == verdict


def test_unbiased_without_mobileface():
    finding = bias.unbiased(numbers({"ours": 0.6, "aldrian": 0.5}), 5)
    assert finding.condition == "compared with Aldrian & Smith"


@pytest.mark.parametrize(
    ("slopes", "verdict", "condition"),
    [
        ({"aldrian": 0.86, "mobileface": 0.65}, HOLDS, ""),
        ({"aldrian": 0.86}, HOLDS, ""),
        ({"aldrian": 0.95, "mobileface": 0.65}, WITH_CONDITION, "of MobileFace"),
        ({"aldrian": 0.95, "mobileface": 1.02}, DOES_NOT_HOLD, ""),
    ],
)
def test_model_based_bias(slopes, verdict, condition):
    finding = bias.model_based_bias(numbers({"ours": 0.2} | slopes), 123)
    assert (finding.verdict, finding.condition) == (verdict, condition)
    assert "123" in finding.evidence
    assert all(str(slope) in finding.evidence for slope in slopes.values())
