"""The criteria: cases computed by hand, and agreement with NumPy and SciPy."""

import numpy as np
import pytest

from deepmds_keras import InputError, align, convert, metrics, normalise
from deepmds_keras.metrics import depth_corr, depth_corr_across_faces, mse

METRICS = (mse, depth_corr, depth_corr_across_faces, metrics.explained_share)


@pytest.fixture
def faces():
    return np.random.default_rng(0).random((7, 12, 3))


def test_one_face_gives_a_float_that_is_the_mean_of_squares(faces):
    prediction = np.array([[3.0, 0, 0], [0, -1, 2]])
    assert mse(prediction, np.zeros((2, 3))) == 14 / 6
    assert isinstance(mse(faces[0], faces[1]), float)
    assert mse(faces[0], faces[1]) == mse(faces[:2], faces[1:3])[0]
    assert depth_corr(faces[0], faces[1]) == depth_corr(faces[:1], faces[1:2])[0]


def test_depth_corr_is_the_trace_of_the_correlation_matrix(faces):
    prediction = faces + 0.3 * np.random.default_rng(1).standard_normal(faces.shape)
    both = zip(prediction, faces, strict=True)
    expected = [np.trace(np.corrcoef(p, t)[: len(p), len(p) :]) for p, t in both]
    np.testing.assert_allclose(depth_corr(prediction, faces), expected)
    flat = faces.copy()
    flat[:, 3] = 0.1  # constant landmarks contribute nothing
    np.testing.assert_allclose(depth_corr(flat, faces), 11)
    np.testing.assert_allclose(depth_corr(faces, flat), 11)


def test_only_depth_counts_across_faces_and_a_constant_answer_scores_zero(faces):
    truth, prediction = np.zeros((2, 3, 2, 3))
    truth[..., 2] = [[0, 1], [1, 0], [2, 0]]
    prediction[..., 2] = [[4, 1], [2, 1], [0, 0]]
    assert depth_corr_across_faces(prediction, truth) == pytest.approx(1 + 0.5)
    constant = np.broadcast_to(faces.mean(0), faces.shape)
    assert depth_corr_across_faces(constant, faces) == 0
    assert depth_corr_across_faces(faces * [2, -1, 1], faces) == pytest.approx(12)


def test_the_truth_explains_everything_and_the_mean_nothing(faces):
    mean = np.broadcast_to(faces.mean(0), faces.shape)
    assert metrics.explained_share(3 * faces * [1, 1, -1], faces) == pytest.approx(1)
    assert metrics.explained_share(mean, faces) < 0.1
    noisy, sizes = faces + 0.1 * np.sin(9 * faces), np.arange(1, 8)[:, None, None]
    shares = [metrics.explained_share(noisy, truth) for truth in (faces, sizes * faces + 7)]
    assert shares[0] == pytest.approx(shares[1]) and shares[0] < 0.99
    with pytest.raises(InputError, match="truth must have faces that differ"):
        metrics.explained_share(faces, faces[0] * np.linspace(1, 2, 7)[:, None, None])


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize(
    ("prediction", "truth", "message"),
    [
        (np.ones((7, 5, 3)), np.ones((7, 12, 3)), r"must have the same shape. Received \(7, 5"),
        (np.ones((7, 12, 2)), np.ones((7, 12, 2)), r"prediction must have shape .*\(7, 12, 2\)"),
        (np.ones((7, 12, 3)), np.full((7, 12, 3), np.nan), "truth must be finite. Received NaN"),
        (np.ones((1, 12, 3)), np.full((1, 12, 3), np.inf), "2 faces or more. Received|truth must"),
    ],
)
def test_unusable_arrays_are_refused(metric, prediction, truth, message):
    with pytest.raises(InputError, match=message):
        metric(prediction, truth)


@pytest.mark.parametrize("compare", [*METRICS, align])
def test_masked_numbers_are_not_taken_for_numbers(compare, faces):
    masked = np.ma.masked_array(faces, faces > 0.9)
    for use in (lambda x: compare(x, faces), lambda x: compare(faces, x), normalise):
        with pytest.raises(InputError, match="must be finite"):
            use(masked)
    given = np.ma.masked_array(np.ones((51, 2)), [[True, False]] * 51)
    assert np.isnan(convert(given, "ibug51", "ibug51")[:, 0]).all()
