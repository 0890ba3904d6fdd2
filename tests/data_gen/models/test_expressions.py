"""Performed and held expressions: exact counts, neutral ends, and landmarks that move as named."""

from dataclasses import replace

import numpy as np
import pytest
from places import SHARED

from data_gen.datasets.frames_standin import make_frames
from data_gen.models.expressions import (
    SCAN_EXPRESSIONS,
    SEQUENCES,
    sample_expressions,
    scan_expression_weights,
    sequence_weights,
)
from data_gen.models.ict import load_ict
from data_gen.models.openhead import load_openhead
from deepmds_keras.errors import InputError
from deepmds_keras.landmarks import load_scheme

ICT = SHARED / "ict-facekit"
SCHEME = load_scheme("ibug51")
NUMBER = {number: i for i, number in enumerate(SCHEME.numbers)}
BROWS = [i for i, group in enumerate(SCHEME.groups) if group.endswith("brow")]
MOUTH = [i for i, group in enumerate(SCHEME.groups) if group.endswith("mouth")]
LIPS = [NUMBER[n] for n in (62, 63, 64)], [NUMBER[n] for n in (68, 67, 66)]
LIDS = [NUMBER[n] for n in (38, 39, 44, 45)], [NUMBER[n] for n in (42, 41, 48, 47)]
CORNERS = [NUMBER[49], NUMBER[55]]  # right, left
MIDLINE_OF_MOUTH = [NUMBER[n] for n in (52, 58, 63, 67)]
N_PERFORMANCES = 8


def landmarks_alone(model):
    return model.restrict(model.landmarks["ibug51"])


@pytest.fixture(scope="module")
def openhead():
    return landmarks_alone(load_openhead())


@pytest.fixture(scope="module")
def ict():
    if not ICT.exists():
        pytest.skip("ICT-FaceKit is not in ../shared")
    return landmarks_alone(load_ict(ICT))


@pytest.fixture(scope="module", params=["openhead", "ict"])
def model(request):
    return request.getfixturevalue(request.param)


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


def test_the_sequences_of_coma_and_the_expressions_of_casia():
    assert len(SEQUENCES) == 12
    assert {"bareteeth", "cheeks_in", "mouth_extreme", "mouth_up"} < set(SEQUENCES)
    assert set(SCAN_EXPRESSIONS) == {
        *("neutral", "smile", "laugh", "anger", "surprise", "eyes_closed")
    }


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


def test_mouth_open_parts_the_lips_and_lowers_the_lower_one(model):
    moved, start = performed(model, "mouth_open")
    opened = gap(start + moved, LIPS) - gap(start, LIPS)
    assert (opened.max(1) > 15).all()
    assert opened.max() < 45
    assert (moved[:, :, LIPS[1], 1].min((1, 2)) < -15).all()


def test_eyebrow_raises_and_lowers_the_brows_and_hardly_moves_the_mouth(model):
    moved, _ = performed(model, "eyebrow")
    height = moved[:, :, BROWS, 1].mean(2)
    assert (height.max(1) > 2).all()
    assert (height.min(1) < -1).all()
    assert (height.argmax(1) < height.argmin(1)).all()
    mouth = np.linalg.norm(moved[:, :, MOUTH], axis=-1).mean(2).max(1)
    assert (mouth < 4).all()
    assert np.median(mouth) < 1
    brows = SCHEME.groups.index("left_brow"), SCHEME.groups.index("right_brow")
    left, right = (moved[..., b : b + 5, 1].mean(2) for b in brows)
    assert ((left - right).max(1) > 3).all()  # the left one alone goes up


def test_high_smile_moves_the_corners_up_and_outwards(model):
    moved, _ = performed(model, "high_smile")
    corners = moved[:, :, CORNERS]
    assert (corners[..., 1].max(1) > 5).all()
    assert (corners[:, :, 0, 0].min(1) < -3).all()
    assert (corners[:, :, 1, 0].max(1) > 3).all()


@pytest.mark.parametrize("sequence", ["mouth_side", "mouth_extreme"])
def test_the_mouth_goes_to_its_left_and_then_to_its_right(model, sequence):
    moved, _ = performed(model, sequence)
    aside = moved[:, :, MIDLINE_OF_MOUTH, 0].mean(2)
    assert (aside.max(1) > 4).all()
    assert (aside.min(1) < -4).all()
    assert (aside.argmax(1) < aside.argmin(1)).all()


def test_mouth_down_and_up_move_the_corners_so(model):
    down, up = (
        performed(model, sequence)[0][:, :, CORNERS, 1].mean(2)
        for sequence in ("mouth_down", "mouth_up")
    )
    assert (down.min(1) < -2.5).all()
    assert (up.max(1) > 2.5).all()


def test_mouth_middle_and_cheeks_in_narrow_the_mouth_and_lips_back_widens_it(model):
    def width(sequence):
        corners = performed(model, sequence)[0][:, :, CORNERS, 0]
        return corners[..., 1] - corners[..., 0]

    assert (width("mouth_middle").min(1) < -5).all()
    assert (width("cheeks_in").min(1) < -4).all()
    assert (width("lips_back").max(1) > 6).all()


@pytest.mark.parametrize("sequence", ["bareteeth", "lips_up"])
def test_teeth_show(model, sequence):
    moved, start = performed(model, sequence)
    assert ((gap(start + moved, LIPS) - gap(start, LIPS)).max(1) > 3).all()
    assert (moved[:, :, LIPS[0], 1].mean(2).max(1) > 2.5).all()


def test_closed_lips_hardly_cross(model):
    start = landmarks(model, np.zeros((1, len(model.expression_names))))[0]
    weights = sample_expressions(model, 2000, np.random.default_rng(0))
    assert (gap(landmarks(model, weights), LIPS) > gap(start, LIPS) - 4).all()


def test_held_expressions_look_as_named(model):
    n = 60
    points = {
        name: landmarks(model, scan_expression_weights(model, [name] * n, np.random.default_rng(0)))
        for name in SCAN_EXPRESSIONS
    }
    neutral = points["neutral"]
    assert np.ptp(neutral, axis=0).max() == 0
    lips, lids = ({name: gap(p, pair) for name, p in points.items()} for pair in (LIPS, LIDS))
    corners = {name: (p - neutral)[:, CORNERS, 1].min(1) for name, p in points.items()}
    brows = {name: (p - neutral)[:, BROWS, 1].mean(1) for name, p in points.items()}
    assert (corners["smile"] > 3).all()
    assert (corners["laugh"] > 3).all()
    assert (lips["laugh"] > lips["smile"] + 4).all()
    assert (brows["anger"] < -1).all()
    assert (brows["surprise"] > 2).all()
    assert (lips["surprise"] > lips["neutral"] + 7).all()
    assert (lids["surprise"] > lids["neutral"] + 1).all()
    assert (lids["eyes_closed"] < 0.3 * lids["neutral"]).all()


def test_many_frames_are_lopsided(model):
    frames = make_frames(model, 6, 1200, np.random.default_rng(0))
    neutral = landmarks(model, 0 * frames.expression[:1])
    moved = landmarks(model, frames.expression) - neutral
    mirrored = moved[:, SCHEME.mirror] * [-1, 1, 1]
    lopsided = np.linalg.norm(moved - mirrored, axis=-1).max(1)
    expressive = np.linalg.norm(moved, axis=-1).max(1) > 2
    assert (lopsided[expressive] > 1).mean() > 0.4
    assert (lopsided[expressive] > 4).mean() > 0.15


def test_symmetric_poses_are_performed_with_one_side_more_than_the_other(openhead):
    left, right = (openhead.expression_names.index(f"mouthSmile{s}") for s in ("Left", "Right"))
    rng = np.random.default_rng(0)
    performances = [sequence_weights(openhead, "high_smile", 40, rng) for _ in range(40)]
    more = np.array([weights[20, left] / weights[20, right] for weights in performances])
    assert (more > 1.05).sum() > 8
    assert (more < 1 / 1.05).sum() > 8
    held = scan_expression_weights(openhead, ["smile"] * 200, rng)
    more = held[:, left] / held[:, right]
    assert (more > 1.05).sum() > 20
    assert (more < 1 / 1.05).sum() > 20
    assert 0.8 < more.min() < more.max() < 1.25


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_open_head_and_ict_make_the_same_expressions(openhead, ict, sequence):
    first, second = (performed(model, sequence, 40)[0] for model in (openhead, ict))
    assert np.corrcoef(first.ravel(), second.ravel())[0, 1] > 0.6


def test_weights_go_by_name(openhead, ict):
    first, second = (sample_expressions(m, 50, np.random.default_rng(1)) for m in (openhead, ict))

    def of(model, weights, name):
        return weights[:, model.expression_names.index(name)]

    for name, its in (
        ("jawOpen", ["jawOpen"]),
        ("mouthLeft", ["mouthLeft"]),
        ("mouthSmileLeft", ["mouthSmile_L"]),
        ("mouthSmileRight", ["mouthSmile_R"]),
        ("browInnerUp", ["browInnerUp_L", "browInnerUp_R"]),
    ):
        assert of(openhead, first, name).any()
        for other in its:
            assert np.array_equal(of(openhead, first, name), of(ict, second, other))


def test_drawn_expressions_are_many_and_within_bounds(model):
    weights = sample_expressions(model, 20_000, np.random.default_rng(0))
    assert weights.shape == (20_000, len(model.expression_names))
    assert weights.min() == 0
    assert weights.max() <= 1.2
    moved = landmarks(model, weights[:2000]) - landmarks(model, 0 * weights[:1])
    assert 1 < np.median(np.linalg.norm(moved, axis=-1).max(1)) < 20
    assert len(np.unique(weights.round(6), axis=0)) == 20_000


@pytest.mark.parametrize(("n_subjects", "n_frames"), [(12, 20_466), (3, 480), (1, 36)])
def test_frames_are_split_evenly_and_in_order(openhead, n_subjects, n_frames):
    frames = make_frames(openhead, n_subjects, n_frames, np.random.default_rng(0))
    assert len(frames) == n_frames
    assert frames.identity.shape == (n_frames, openhead.n_identity)
    assert frames.expression.shape == (n_frames, len(openhead.expression_names))
    assert frames.identity.dtype == frames.expression.dtype == np.float32
    performance = frames.subject * len(SEQUENCES) + frames.sequence
    numbers, starts, counts = np.unique(performance, return_index=True, return_counts=True)
    assert numbers.tolist() == list(range(12 * n_subjects))
    assert set(counts) <= {n_frames // len(numbers), -(-n_frames // len(numbers))}
    assert (np.diff(performance) >= 0).all()
    ends = np.concatenate([starts, starts + counts - 1])
    assert not frames.expression[ends].any()
    assert (np.maximum.reduceat(frames.expression, starts).max(1) > 0.3).all()


def test_a_subject_keeps_its_identity(openhead):
    frames = make_frames(openhead, 3, 480, np.random.default_rng(0))
    different, subjects = np.unique(frames.identity, axis=0, return_inverse=True)
    assert len(different) == 3
    assert len({*zip(frames.subject.tolist(), subjects.ravel().tolist(), strict=True)}) == 3
    assert abs(different.std() - 1) < 0.1


def test_no_two_performances_are_the_same(openhead):
    rng = np.random.default_rng(0)
    first, second = (sequence_weights(openhead, "mouth_open", 50, rng) for _ in range(2))
    assert np.abs(first - second).max() > 0.05


def test_same_random_numbers_same_expressions(openhead):
    def draws(seed):
        rng = np.random.default_rng(seed)
        return [
            *vars(make_frames(openhead, 1, 120, rng)).values(),
            scan_expression_weights(openhead, SCAN_EXPRESSIONS, rng),
            sample_expressions(openhead, 20, rng),
        ]

    first, again, other = draws(5), draws(5), draws(6)
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not any(np.array_equal(first[i], other[i]) for i in (0, 1, -2, -1))


@pytest.mark.parametrize("names", [(), tuple(f"expression_{k}" for k in range(51))])
def test_a_model_of_unknown_expressions_is_refused(openhead, names):
    unknown = replace(openhead, name="pca_head", expression_names=names)
    rng = np.random.default_rng(0)
    for call in (
        lambda: sequence_weights(unknown, "mouth_open", 10, rng),
        lambda: scan_expression_weights(unknown, ["smile"], rng),
        lambda: sample_expressions(unknown, 10, rng),
        lambda: make_frames(unknown, 1, 100, rng),
    ):
        with pytest.raises(InputError, match="pca_head: .*openhead and ict"):
            call()


def test_unknown_names_and_too_few_frames_are_refused(openhead):
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="sequence must be one of bareteeth.*Received 'yawn'"):
        sequence_weights(openhead, "yawn", 10, rng)
    with pytest.raises(InputError, match="expression must be one of neutral.*Received 'yawn'"):
        scan_expression_weights(openhead, ["smile", "yawn"], rng)
    with pytest.raises(InputError, match="n_frames must be at least 72 .* Received 71"):
        make_frames(openhead, 2, 71, rng)
    with pytest.raises(InputError, match="n_subjects must be at least 1. Received 0"):
        make_frames(openhead, 0, 100, rng)
