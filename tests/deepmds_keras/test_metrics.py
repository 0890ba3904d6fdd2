"""Laws of the criteria: hand-computed cases, bounds, agreement with NumPy and SciPy."""

import numpy as np
import pytest
from scipy.stats import norm, wilcoxon

from deepmds_keras.errors import InputError
from deepmds_keras.metrics import depth_corr, depth_corr_across_faces, mse, wilcoxon_table


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture
def faces(rng):
    return rng.random((7, 12, 3))


def test_mse_is_the_mean_of_squares_over_all_coordinates():
    truth = np.zeros((2, 2, 3))
    prediction = truth.copy()
    prediction[1, 0] = [3, 0, 0]
    prediction[1, 1] = [0, -1, 2]
    np.testing.assert_allclose(mse(prediction, truth), [0, 14 / 6])


def test_one_face_gives_a_float(faces):
    assert isinstance(mse(faces[0], faces[1]), float)
    assert mse(faces[0], faces[1]) == mse(faces[:1], faces[1:2])[0]
    assert depth_corr(faces[0], faces[1]) == depth_corr(faces[:1], faces[1:2])[0]


def test_the_truth_scores_zero_mse_and_full_correlation(faces):
    np.testing.assert_array_equal(mse(faces, faces), 0)
    np.testing.assert_allclose(depth_corr(faces, faces), 12)
    assert depth_corr_across_faces(faces, faces) == pytest.approx(12)


def test_depth_corr_is_the_trace_of_the_correlation_matrix(faces, rng):
    prediction = faces + 0.3 * rng.standard_normal(faces.shape)
    expected = [
        np.trace(np.corrcoef(p, t)[: len(p), len(p) :])
        for p, t in zip(prediction, faces, strict=True)
    ]
    np.testing.assert_allclose(depth_corr(prediction, faces), expected)


def test_depth_corr_by_hand():
    truth = np.array([[0.0, 1, 2], [0, 1, 2]])
    prediction = np.array([[0.0, 5, 10], [2, 1, 0]])
    assert depth_corr(prediction, truth) == pytest.approx(0)
    assert depth_corr(prediction[:1], truth[:1]) == pytest.approx(1)


def test_depth_corr_hardly_sees_the_face_when_depth_lies_apart(rng):
    """Depth far from x and y, as where a face is min-max scaled about the model's origin."""
    spread = np.array([0.15, 0.15, 0.1])
    truth = [0.3, 0.3, 0.8] + spread * rng.standard_normal((50, 72, 3))
    cloud = [0.3, 0.3, 0.8] + spread * rng.standard_normal((50, 72, 3))
    assert depth_corr(cloud, truth).mean() > 50
    centre = np.array([0.3, 0.3, 0.8])
    assert abs(depth_corr(cloud - centre, truth - centre).mean()) < 3


def test_constant_landmarks_contribute_nothing(faces):
    flat = faces.copy()
    flat[:, 3] = 0.1
    np.testing.assert_allclose(depth_corr(flat, faces), 11)
    np.testing.assert_allclose(depth_corr(faces, flat), 11)


def test_depth_across_faces_by_hand():
    truth, prediction = np.zeros((3, 2, 3)), np.zeros((3, 2, 3))
    truth[..., 2] = [[0, 1], [1, 0], [2, 0]]
    prediction[..., 2] = [[4, 1], [2, 1], [0, 0]]
    assert depth_corr_across_faces(prediction, truth) == pytest.approx(1 + 0.5)


def test_a_constant_answer_scores_zero_across_faces(faces):
    constant = np.repeat(faces.mean(axis=0, keepdims=True), len(faces), axis=0)
    assert depth_corr_across_faces(constant, faces) == 0


def test_only_depth_counts_across_faces(faces, rng):
    moved = faces.copy()
    moved[..., :2] = rng.random(moved[..., :2].shape)
    assert depth_corr_across_faces(moved, faces) == pytest.approx(12)


@pytest.mark.parametrize("metric", [mse, depth_corr, depth_corr_across_faces])
def test_unusable_arrays_are_refused(metric, faces):
    broken = faces.copy()
    broken[0, 0, 0] = np.nan
    with pytest.raises(InputError, match=r"prediction and truth must have one shape. Received"):
        metric(faces, faces[:, :5])
    with pytest.raises(InputError, match=r"prediction must have shape .* Received shape \(7, 12"):
        metric(faces[..., :2], faces)
    with pytest.raises(InputError, match=r"truth must be finite. Received 1 numbers"):
        metric(faces, broken)


def test_across_faces_needs_two_faces(faces):
    with pytest.raises(InputError, match=r"two faces or more.* Received shape \(1, 12, 3\)"):
        depth_corr_across_faces(faces[:1], faces[:1])


def test_wilcoxon_agrees_with_scipy(rng):
    a, b = rng.standard_normal((2, 30))
    row = wilcoxon_table({"a": a, "b": b}).iloc[0]
    expected = wilcoxon(a, b)
    assert (row["statistic"], row["p_value"]) == (expected.statistic, expected.pvalue)
    assert row["median_difference"] == np.median(a - b)


def test_ten_differences_of_one_sign(rng):
    row = wilcoxon_table({"a": np.arange(10.0), "b": 1.5 * np.arange(10) + 1}).iloc[0]
    assert row["n"] == 10
    assert row["p_value"] == 2 * 0.5**10 == 0.001953125


def test_the_p_value_of_the_paper_takes_twenty_differences():
    numbers = np.arange(1.0, 21)
    row = wilcoxon_table({"a": numbers, "b": np.zeros(20)}).iloc[0]
    assert row["p_value_normal"] == pytest.approx(2 * norm.sf(105 / np.sqrt(717.5)))
    assert row["p_value_normal"] == pytest.approx(8.857e-5, rel=1e-4)
    assert row["p_value"] < 1e-5


def test_the_normal_approximation_allows_for_ties_and_zeros():
    row = wilcoxon_table({"a": np.array([0, 1, 1, 1, -2, 3, 3.0]), "b": np.zeros(7)}).iloc[0]
    n, rank_sum, ties = 6, 4, (3**3 - 3) + (2**3 - 2)
    variance = n * (n + 1) * (2 * n + 1) / 24 - ties / 48
    z = (rank_sum - n * (n + 1) / 4) / np.sqrt(variance)
    assert row["p_value_normal"] == pytest.approx(2 * norm.cdf(z))


def test_every_two_methods_are_compared_once(rng):
    values = dict(zip("abcd", rng.random((4, 15)), strict=True))
    table = wilcoxon_table(values)
    assert [*zip(table["method_a"], table["method_b"], strict=True)] == [
        ("a", "b"), ("a", "c"), ("a", "d"), ("b", "c"), ("b", "d"), ("c", "d"),
    ]  # fmt: skip


def test_equal_methods_do_not_differ():
    row = wilcoxon_table({"a": np.ones(10), "b": np.ones(10)}).iloc[0]
    assert (row["p_value"], row["p_value_normal"], row["median_difference"]) == (1, 1, 0)


def test_unequal_lengths_are_refused():
    with pytest.raises(InputError, match=r"as many for every method. Received a 3, b 2"):
        wilcoxon_table({"a": np.ones(3), "b": np.ones(2)})
    with pytest.raises(InputError, match=r"values of a must be a row of finite numbers"):
        wilcoxon_table({"a": np.ones((3, 2)), "b": np.ones(3)})
