"""The limit: the posterior of a linear-Gaussian toy, and below every method."""

from dataclasses import replace

import numpy as np
import pytest

from deepmds_keras import align, normalise
from deepmds_keras.metrics import mse
from experiments.lifting.contenders import PREDICT
from experiments.lifting.limit import limit, posterior_draws
from experiments.lifting.views import CONDITIONS, hard_faces, landmark_model
from experiments.presets import TINY
from experiments.run import Run

BY_ID = {condition.id: condition for condition in CONDITIONS}


@pytest.fixture(scope="module")
def run():
    return Run("openhead", replace(TINY, test_faces=40))


def errors(run, name):
    rng = np.random.default_rng(0)
    return limit(landmark_model(run), hard_faces(run, BY_ID[name]), rng)


def test_draws_have_the_posterior_covariance_of_a_linear_gaussian_toy():
    """With the similarity eliminated by hand: what it can explain tells nothing."""
    rng = np.random.default_rng(0)
    k, n_landmarks, copies = 3, 6, 20_000
    jacobian, view = rng.standard_normal((k, n_landmarks, 2)), rng.standard_normal((n_landmarks, 2))
    certainty = np.array([1, 2, 0, 1, 0.5, 1])
    weight = np.repeat(certainty, 2)
    similarity = np.concatenate([view.reshape(1, -1), np.tile(np.eye(2), n_landmarks)]) * weight
    explained = np.linalg.qr(similarity.T)[0]
    told = jacobian.reshape(k, -1) * weight
    told = told - told @ explained @ explained.T
    expected = np.linalg.inv(told @ told.T + np.eye(k))
    given = (np.tile(a, (copies, *[1] * a.ndim)) for a in (jacobian, view, certainty))
    draws = posterior_draws(*given, rng).reshape(-1, k)
    np.testing.assert_allclose(np.cov(draws, rowvar=False), expected, atol=0.01)
    np.testing.assert_allclose(draws.mean(0), 0, atol=0.01)


def test_what_is_missing_is_as_if_it_was_never_there():
    rng = np.random.default_rng(0)
    jacobian, views = rng.standard_normal((2, 4, 9, 2)), rng.standard_normal((2, 9, 2))
    views[:, 6:] = views[:, :6].mean(1, keepdims=True)  # both are then centred alike
    certainty = np.ones((2, 9))
    certainty[:, 6:] = 0
    whole = posterior_draws(jacobian, views, certainty, np.random.default_rng(1))
    rest = jacobian[:, :, :6], views[:, :6], certainty[:, :6]
    np.testing.assert_allclose(whole, posterior_draws(*rest, np.random.default_rng(1)), rtol=1e-6)


def test_the_limit_grows_with_noise_and_with_missing_landmarks(run):
    noise = [errors(run, name).mean() for name in ("hard_0", "hard_1", "hard_3")]
    missing = [errors(run, f"hard_1_missing_{n}").mean() for n in (30, 50)]
    assert noise[0] < noise[1] / 5 < noise[2] / 10
    assert noise[1] < missing[0] < missing[1]


@pytest.mark.parametrize(
    "name", ["hard_1_missing_50", pytest.param("paper_0", marks=pytest.mark.slow)]
)
def test_every_method_is_above_the_limit(run, name):
    faces, best = hard_faces(run, BY_ID[name]), errors(run, name).mean()
    truth = normalise(faces.shapes)
    for method, predict in PREDICT.items():
        own = mse(align(predict(run, BY_ID[name], faces), truth), truth).mean()
        assert own > best, method
