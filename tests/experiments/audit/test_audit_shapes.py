"""Topics on shapes, where the answer is known: bias, ranks, depth, samplings."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from deepmds_keras.geometry.alignment import align
from deepmds_keras.geometry.units import normalise
from experiments.audit import shapes
from experiments.scoring.scores import Scores

N, L = 400, 30


def faces(rng, n=N):
    """A mean shape, and faces that differ from it in 12 ways."""
    mean = rng.uniform(0, 1, (L, 3))
    ways = rng.normal(0, 0.01, (12, L, 3))
    return mean, mean + np.tensordot(rng.standard_normal((n, 12)), ways, 1)


def measured(predicted, mean, truth):
    """As predictions are scored: each aligned to its truth."""
    return shapes.bias_of(
        align(predicted, truth), align(np.broadcast_to(mean, truth.shape), truth), truth
    )


# Noise of 0.035 is as large as the offsets. What is the same in every face is no bias either.
@pytest.mark.parametrize("noise, size, within", [(0, (1, 1), 0.01), (0.035, (L, 3), 0.03),
                                                 (0.035, (N, L, 3), 0.03)])  # fmt: skip
@pytest.mark.parametrize("part", [0, 0.25, 1, 1.3])
def test_slope_is_the_recovered_part_of_the_offset_whatever_the_noise(
    rng, part, noise, size, within
):
    mean, truth = faces(rng)
    predicted = mean + part * (truth - mean) + rng.normal(0, noise, size)
    bias = measured(predicted, mean, truth)
    assert bias["slope"] == pytest.approx(part, abs=within)


def test_standard_error_is_the_spread_over_samples_of_faces(rng):
    mean, truth = faces(rng, 40 * 60)
    predicted = truth + rng.normal(0, 0.05, truth.shape)
    samples = [measured(predicted[i::40], mean, truth[i::40]) for i in range(40)]
    spread = np.std([bias["slope"] for bias in samples], ddof=1)
    assert np.mean([bias["slope_se"] for bias in samples]) == pytest.approx(spread, rel=0.35)


@pytest.fixture(scope="module")
def evidence():
    truth = normalise(np.random.default_rng(0).normal(0, (3, 2, 1), (4, 24, 3)))
    mean = np.broadcast_to(truth.mean(0), truth.shape)
    predictions = {"mean_shape": mean, "deep_mds": mean + 0.5 * (truth - mean)}
    return SimpleNamespace(
        run=SimpleNamespace(),
        methods=("aldrian_authors", *predictions),
        test=SimpleNamespace(shapes=truth),
        audited=np.arange(4),
        shapes=truth,
        rng=lambda stream: np.random.default_rng([0, stream]),
        scores=lambda method: Scores(align(predictions[method], truth), truth, None, None),
    )


def test_bias_is_of_the_methods_that_see_the_same_views(evidence):
    table = shapes.bias(evidence).set_index("method")
    assert [*table.index] == ["mean_shape", "deep_mds"]
    assert table.loc["mean_shape", "slope"] == 0 < table.loc["deep_mds", "slope"] < 1


def test_the_best_constant_view_is_the_mean_of_the_frontal_ones(evidence, monkeypatch):
    monkeypatch.setattr(shapes, "load_faces", lambda *_: evidence)
    frontal = evidence.shapes[..., :2]
    expected = ((frontal - frontal.mean(0)) ** 2).mean()
    assert shapes.constants(evidence)["mse"].tolist() == [pytest.approx(expected)]


def test_distances_of_d_dimensions_have_rank_d(evidence):
    table = shapes.ranks(evidence)
    assert [*table["dimensions"]] == [1, 2, 3, 4, 5, 6, 3]
    assert (table["centred"] == table["dimensions"]).all()


def test_answers_without_depth_have_a_share_of_the_depth_correlation(evidence, monkeypatch):
    mean_shape = np.broadcast_to(evidence.shapes.mean(0), evidence.shapes.shape)
    monkeypatch.setattr(shapes, "load_prediction", lambda *_: ({"shapes": mean_shape}, {}))
    shares = shapes.depth(evidence).set_index("answer")["share"]
    assert shares["truth"] == 1
    assert shares["flat"] > 0.9 > shares["mean_shape"] > shares["point"]


def test_samplings_find_differences_between_exchangeable_methods_and_faces_seldom_do():
    difference = np.random.default_rng(1).standard_normal(1000)
    rates = shapes.false_positives(
        difference, [10, 50], 100, np.random.default_rng(2), simulations=300
    )
    # What the faces of the test set have in common has 1/9 of the variance of a sampling's mean,
    # and every sampling has it: 10 of them vary by 1 + 10/9 times what the test reckons with.
    assert rates["10"] == pytest.approx(2 * norm.sf(1.96 / (1 + 10 / 9) ** 0.5), abs=0.06)
    assert rates["50"] > rates["10"] + 0.1
    assert rates["faces"] < 0.09
