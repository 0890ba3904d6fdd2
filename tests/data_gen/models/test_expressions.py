"""Performed and held expressions: neutral ends, and landmarks that move as named."""

from dataclasses import replace

import numpy as np
import pytest

from data_gen.models.expressions import (
    SCAN_EXPRESSIONS,
    SEQUENCES,
    sample_expressions,
    scan_expression_weights,
    sequence_weights,
)
from deepmds_keras.errors import InputError
from deepmds_keras.landmarks import load_scheme

SCHEME = load_scheme("ibug51")
NUMBER = {number: i for i, number in enumerate(SCHEME.numbers)}
BROWS = [i for i, group in enumerate(SCHEME.groups) if group.endswith("brow")]
LIPS = [NUMBER[n] for n in (62, 63, 64)], [NUMBER[n] for n in (68, 67, 66)]
LIDS = [NUMBER[n] for n in (38, 39, 44, 45)], [NUMBER[n] for n in (42, 41, 48, 47)]
CORNERS = [NUMBER[49], NUMBER[55]]  # right, left
MIDLINE_OF_MOUTH = [NUMBER[n] for n in (52, 58, 63, 67)]
N_PERFORMANCES = 8


@pytest.fixture(scope="module", params=["head", "ict"])
def model(request):
    return request.getfixturevalue(request.param).at_landmarks("ibug51")


def landmarks(model, weights):
    """Landmarks of the mean face with these expressions, `(..., 51, 3)`."""
    return model.shape(np.zeros((1, model.n_identity)), weights)


def performed(model, sequence, n_frames=100):
    """How landmarks move in a few performances, `(performances, frames, 51, 3)`; their start."""
    rng = np.random.default_rng(0)
    weights = [sequence_weights(model, sequence, n_frames, rng) for _ in range(N_PERFORMANCES)]
    points = landmarks(model, np.array(weights))
    return points - points[:, :1], points[0, 0]


def gap(points, pairs):
    """Mean height of the upper landmarks above the lower ones, `(...,)`."""
    upper, lower = pairs
    return (points[..., upper, 1] - points[..., lower, 1]).mean(-1)


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_every_sequence_is_neutral_at_both_ends_only_and_smooth(model, sequence):
    weights = sequence_weights(model, sequence, 200, np.random.default_rng(3))
    assert weights.shape == (200, len(model.expression_names))
    assert (weights[[0, -1]] == 0).all()
    assert weights.min() >= 0
    assert 0.5 < weights.max() <= 1.2
    moved = np.linalg.norm(landmarks(model, weights) - landmarks(model, weights[:1]), axis=-1)
    assert moved.max() > 4
    assert (moved[40:-40].max(1) > 1).all()
    assert np.abs(np.diff(weights, axis=0)).max() < 0.1


def test_sequences_move_what_they_name(model):
    moved, start = performed(model, "mouth_open")
    opened = gap(start + moved, LIPS) - gap(start, LIPS)
    assert (opened.max(1) > 15).all() and opened.max() < 45
    moved, _ = performed(model, "eyebrow")
    height = moved[:, :, BROWS, 1].mean(2)
    assert (height.max(1) > 2).all() and (height.min(1) < -1).all()
    corners = performed(model, "high_smile")[0][:, :, CORNERS]
    assert (corners[..., 1].max(1) > 5).all()
    for sequence in ("mouth_side", "mouth_extreme"):  # to its left, then to its right
        aside = performed(model, sequence)[0][:, :, MIDLINE_OF_MOUTH, 0].mean(2)
        assert (aside.max(1) > 4).all() and (aside.min(1) < -4).all()
        assert (aside.argmax(1) < aside.argmin(1)).all()


def test_held_expressions_look_as_named(model):
    points = {
        name: landmarks(
            model, scan_expression_weights(model, [name] * 60, np.random.default_rng(0))
        )
        for name in SCAN_EXPRESSIONS
    }
    neutral = points["neutral"]
    assert np.ptp(neutral, axis=0).max() == 0
    lips, lids = ({name: gap(p, pair) for name, p in points.items()} for pair in (LIPS, LIDS))
    for name in ("smile", "laugh"):
        assert ((points[name] - neutral)[:, CORNERS, 1].min(1) > 3).all()
    assert (lips["laugh"] > lips["smile"] + 4).all()
    assert ((points["anger"] - neutral)[:, BROWS, 1].mean(1) < -1).all()
    assert ((points["surprise"] - neutral)[:, BROWS, 1].mean(1) > 2).all()
    assert (lips["surprise"] > lips["neutral"] + 7).all()
    assert (lids["eyes_closed"] < 0.3 * lids["neutral"]).all()


def test_drawn_expressions_are_many_within_bounds_and_keep_the_lips_apart(model):
    weights = sample_expressions(model, 20_000, np.random.default_rng(0))
    assert weights.shape == (20_000, len(model.expression_names))
    assert weights.min() == 0
    assert weights.max() <= 1.2
    assert len(np.unique(weights.round(6), axis=0)) == 20_000
    faces, start = landmarks(model, weights[:2000]), landmarks(model, 0 * weights[:1])
    assert 1 < np.median(np.linalg.norm(faces - start, axis=-1).max(1)) < 20
    assert (gap(faces, LIPS) > gap(start, LIPS) - 4).all()


def test_open_head_and_ict_make_the_same_expressions(head, ict):
    models = [model.at_landmarks("ibug51") for model in (head, ict)]
    for sequence in SEQUENCES:
        first, second = (performed(model, sequence, 40)[0] for model in models)
        assert np.corrcoef(first.ravel(), second.ravel())[0, 1] > 0.6, sequence


@pytest.mark.parametrize("names", [(), tuple(f"expression_{k}" for k in range(51))])
def test_unknown_expressions_are_refused(head, names):
    unknown, rng = replace(head, name="pca", expression_names=names), np.random.default_rng(0)
    for call in (
        lambda: sequence_weights(unknown, "mouth_open", 10, rng),
        lambda: scan_expression_weights(unknown, ["smile"], rng),
        lambda: sample_expressions(unknown, 10, rng),
    ):
        with pytest.raises(InputError, match="pca: .*openhead and ict"):
            call()
