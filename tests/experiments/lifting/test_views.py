"""Views of the protocol `hard`, what methods do about missing landmarks, and the lower bound."""

from dataclasses import replace

import numpy as np
import pytest

from deepmds_keras.geometry.views import project
from experiments.lifting import views
from experiments.lifting.contenders import (
    aligned_mse,
    fill,
    lower_bound,
    posterior_draws,
    simple_methods,
)
from experiments.presets import TINY
from experiments.run import Run

pytestmark = pytest.mark.usefixtures("one_thread")
BY_ID = {condition.id: condition for condition in views.CONDITIONS}
RUN = Run("openhead", replace(TINY, test_faces=60), jobs=1)


def faces_of(name):
    return views.hard_views(RUN, BY_ID[name])


def test_conditions_of_a_protocol_share_faces():
    exact = faces_of("hard_0")
    for name, noise in (("hard_1", 1), ("hard_3", 3)):
        faces = faces_of(name)
        assert np.array_equal(faces.identity, exact.identity)
        assert np.array_equal(faces.cameras.yaw, exact.cameras.yaw)
        sd = noise / 100 * views.FACE_MM
        assert np.std(faces.views - exact.views) == pytest.approx(sd, rel=0.03)
        assert (faces.sd_mm == sd).all()
    np.testing.assert_array_equal(exact.views, project(exact.shapes, exact.cameras))
    assert not np.array_equal(faces_of("paper_0").identity, exact.identity)


def test_what_is_missing_at_one_share_is_missing_at_more():
    missing = [np.isnan(faces_of(f"hard_1_missing_{n}").views) for n in (30, 50)]
    assert [mask.mean() for mask in missing] == pytest.approx([0.3, 0.5], abs=0.03)
    assert not (missing[0] & ~missing[1]).any()


def test_turned_heads_hide_more_landmarks():
    faces = faces_of("hard_1_hidden")
    hidden = np.isnan(faces.views).all(-1)
    turned = np.abs(faces.cameras.yaw)
    assert hidden[turned > 40].sum(1).mean() > 2 * hidden[turned < 20].sum(1).mean()


def test_training_faces_are_others_and_miss_any_share_of_their_landmarks():
    condition = BY_ID["hard_1_hidden"]
    faces = views.training_views(RUN, condition)[:500]
    missing = np.isnan(faces.views[..., 0]).mean(1)
    assert missing.min() < 0.02
    assert 0.9 * views.MOST_MISSING < missing.max() < views.MOST_MISSING + 0.15
    train = views.training_views(RUN, BY_ID["hard_1"])
    assert len(train) == TINY.train_faces and np.isfinite(train.views).all()
    assert not np.isin(train.identity, faces_of("hard_1").identity).any()


def test_missing_coordinates_are_filled_in_better_than_by_their_mean():
    faces, whole = faces_of("hard_1_missing_30"), faces_of("hard_1")
    missing = np.isnan(faces.views)
    train = views.training_views(RUN, BY_ID["hard_1"]).views
    filled = fill(faces.views, train)
    assert np.array_equal(filled[~missing], faces.views[~missing])
    off = np.std((filled - whole.views)[missing])
    assert off < 0.3 * np.std((train.mean(0) - whole.views)[missing])


def test_draws_have_the_posterior_covariance_of_a_linear_gaussian_toy():
    """With the similarity eliminated by hand: what it can explain tells nothing."""
    rng = np.random.default_rng(0)
    k, n_landmarks, copies = 3, 6, 20_000
    jacobian, view = rng.standard_normal((k, n_landmarks, 2)), rng.standard_normal((n_landmarks, 2))
    certainty = np.array([1, 2, 0, 1, 0.5, 1])
    weight = np.repeat(certainty, 2)
    similarity = np.concatenate([view.reshape(1, -1), np.tile(np.eye(2), n_landmarks)]) * weight
    explained = np.linalg.qr(similarity.T)[0]
    left = jacobian.reshape(k, -1) * weight
    left = left - left @ explained @ explained.T
    expected = np.linalg.inv(left @ left.T + np.eye(k))
    given = (np.tile(a, (copies, *[1] * a.ndim)) for a in (jacobian, view, certainty))
    draws = posterior_draws(*given, rng).reshape(-1, k)
    np.testing.assert_allclose(np.cov(draws, rowvar=False), expected, atol=0.01)
    np.testing.assert_allclose(draws.mean(0), 0, atol=0.01)


def test_the_limit_grows_with_noise_and_with_missing_landmarks_and_is_below_all():
    names = "hard_0", "hard_1", "hard_3", "hard_1_missing_30", "hard_1_missing_50"
    best = {n: lower_bound(RUN, faces_of(n)[:30], np.random.default_rng(0)).mean() for n in names}
    assert best["hard_0"] < best["hard_1"] / 5 < best["hard_3"] / 10
    assert best["hard_1"] < best["hard_1_missing_30"] < best["hard_1_missing_50"]
    faces = faces_of(names[-1])[:30]
    shapes = simple_methods(RUN, BY_ID[names[-1]], faces)
    assert {*shapes} == {"mean_shape", "ridge", "ridge_roll_aligned", "mlp", "aldrian", "map"}
    for method, found in shapes.items():
        assert aligned_mse(found, faces.shapes).mean() > best[names[-1]], method
