"""Fitting the face model to 2D landmarks: known faces and poses come back from their views."""

from dataclasses import replace

import numpy as np
import pytest
from faces import degrees_between, rotation_of

from data_gen import landmark_fitting
from data_gen.landmark_fitting import LandmarkFitter
from deepmds_keras.errors import InputError

pytestmark = pytest.mark.usefixtures("one_thread")
SCALE, SHIFT = 2.5, np.array([320.0, -240.0])  # pixels per mm, pixels


@pytest.fixture(scope="module")
def fitter(head):
    return LandmarkFitter(head)


def landmarks_of(head, identity, expression=None):
    return head.shape(identity, expression)[head.landmarks["ibug51"]]


def seen(points, rotation, noise=0.0, rng=None):
    pixels = SCALE * points @ rotation[:2].T + SHIFT
    return pixels if rng is None else pixels + rng.normal(0, noise * SCALE, pixels.shape)


def rms(head, fit, pixels):
    """Root mean square distance of the projected from the given landmarks, pixels."""
    projected = fit.camera.project(landmarks_of(head, fit.identity, fit.expression))
    return np.sqrt(((projected - pixels) ** 2).sum(1).mean())


@pytest.mark.parametrize("yaw", [-45, -20, 0, 20, 45])
def test_face_and_pose_come_back_from_an_exact_view_where_the_prior_is_weak(head, rng, yaw):
    identity = rng.standard_normal(20)
    truth, pose = landmarks_of(head, identity), rotation_of(yaw, 10, -15)
    fit = LandmarkFitter(head, n_identity=20, n_expression=0, landmark_sd=0.001).fit(
        seen(truth, pose)
    )
    assert fit.converged and fit.n_iterations < 15
    assert rms(head, fit, seen(truth, pose)) / SCALE < 0.005
    assert degrees_between(fit.camera.rotation, pose) < 0.1
    assert fit.camera.scale == pytest.approx(SCALE, rel=1e-3)
    np.testing.assert_allclose(fit.identity, identity, atol=0.05)
    assert fit.expression is None


def test_an_expression_is_explained_by_expression_and_not_by_identity(head, fitter):
    opened = 0.7 * (np.array(head.expression_names) == "jawOpen")
    pixels = seen(landmarks_of(head, np.zeros(1), opened), rotation_of())
    fit, neutral = fitter.fit(pixels), LandmarkFitter(head, n_expression=0).fit(pixels)
    assert np.linalg.norm(fit.identity) < 1 < 3 < np.linalg.norm(neutral.identity)
    assert rms(head, fit, pixels) < rms(head, neutral, pixels) / 5
    assert head.expression_names[fit.expression.argmax()] == "jawOpen"
    # The prior of the expressions is the model's.
    wide = LandmarkFitter(replace(head, expression_sd=1.0)).fit(pixels)
    narrow = LandmarkFitter(replace(head, expression_sd=0.05)).fit(pixels)
    weights = [np.linalg.norm(some.expression) for some in (narrow, fit, wide)]
    assert weights == sorted(weights) and weights[2] > 1.1 * weights[1]


def test_at_the_fit_every_coefficient_balances_prior_against_residuals(head, rng, monkeypatch):
    monkeypatch.setattr(landmark_fitting, "_TOLERANCE", 1e-12)
    pixels = seen(landmarks_of(head, rng.standard_normal(100)), rotation_of(-30, 10, 0), 1.5, rng)
    fit = LandmarkFitter(head).fit(pixels)
    assert fit.converged and fit.n_iterations < 25
    landmarks = head.landmarks["ibug51"]
    shape = landmarks_of(head, fit.identity, fit.expression)
    residuals = (pixels - fit.camera.project(shape)) / fit.camera.scale
    basis = np.concatenate(
        [head.identity_basis_times_sd[:100, landmarks], head.expression_basis[:, landmarks]]
    )
    pull = np.einsum("kld,ld->k", basis @ fit.camera.rotation[:2].T, residuals)
    held = np.concatenate([fit.identity, fit.expression / 0.3**2])
    # The unit of the noise is the scale that the fit started from, up to a tenth from its last.
    variance = (pull @ held) / (held @ held)
    assert 1.3 < np.sqrt(variance) < 1.7
    np.testing.assert_allclose(pull, variance * held, atol=1e-3)
    x, y, z = fit.camera.rotation @ (shape - shape.mean(0)).T
    u, v = residuals.T
    for derivative in (-z @ v, z @ u, x @ v - y @ u, x @ u + y @ v, u.sum(), v.sum()):
        assert abs(derivative) < 0.01  # turns, scale, shifts: nothing holds them back


def test_more_steps_never_make_a_worse_fit_however_far_the_model_is(head, monkeypatch):
    rng = np.random.default_rng(2)
    pixels = seen(landmarks_of(head, rng.standard_normal(100)), rotation_of(50, 0, 0), 3, rng)
    fitter = LandmarkFitter(head, n_identity=30, n_expression=0, landmark_sd=0.001)
    fits = []
    for n in range(1, 40):
        monkeypatch.setattr(landmark_fitting, "_MAX_ITERATIONS", n)
        fits.append(fitter.fit(pixels))
    missed = np.array([rms(head, fit, pixels) for fit in fits])
    assert (np.diff(missed) <= 1e-9).all()
    assert missed[-1] < 0.8 * missed[0]
    assert not fits[0].converged and fits[-1].converged


def test_points_that_cannot_be_a_face_are_refused(head, fitter):
    pixels = seen(landmarks_of(head, np.zeros(1)), rotation_of())
    for points, message in (
        (np.ones((51, 2)), "not lie on one line. Received an extent of 0 by 0"),
        (pixels * (1, -1), "seen from the front, x to the right and y up"),
        (pixels * (-1, 1), "seen from behind or mirrored"),
    ):
        with pytest.raises(InputError, match=message):
            fitter.fit(points)
    with pytest.raises(InputError, match="scheme must be one of bfm72, ibug68, ibug51 .* 'x'"):
        LandmarkFitter(head, "x")
