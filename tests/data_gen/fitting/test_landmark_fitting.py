"""Fitting the face model to 2D landmarks: known faces and poses come back from their views."""

import dataclasses

import numpy as np
import pytest

from data_gen.fitting.landmark_fitting import LandmarkFitter
from data_gen.models.openhead import load_openhead
from data_gen.views.projections import Cameras, rotations
from deepmds_keras.errors import InputError

pytestmark = pytest.mark.usefixtures("one_thread")
SCALE, SHIFT = 2.5, np.array([320.0, -240.0])  # pixels per mm, pixels


@pytest.fixture(scope="module")
def model():
    return load_openhead()


@pytest.fixture(scope="module")
def fitter(model):
    return LandmarkFitter(model)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def rotation_of(yaw=0.0, pitch=0.0, roll=0.0):
    angles = (np.array([float(angle)]) for angle in (yaw, pitch, roll))
    return rotations(Cameras(np.zeros(1, int), *angles, np.zeros(1)))[0]


def landmarks_of(model, identity, expression=None):
    return model.shape(identity, expression)[model.landmarks["ibug51"]]


def seen(points, rotation, noise=0.0, rng=None):
    pixels = SCALE * points @ rotation[:2].T + SHIFT
    return pixels if rng is None else pixels + rng.normal(0, noise * SCALE, pixels.shape)


def angle(a, b):
    return np.rad2deg(np.arccos(np.clip((np.trace(a.T @ b) - 1) / 2, -1, 1)))


def expression_of(model, **weights):
    expression = np.zeros(len(model.expression_names))
    for name, weight in weights.items():
        expression[model.expression_names.index(name)] = weight
    return expression


def distances(a, b):
    return np.linalg.norm(a - b, axis=-1)


@pytest.mark.parametrize("yaw", [-45, -20, 0, 20, 45])
def test_face_and_pose_come_back_from_an_exact_view_where_the_prior_is_weak(model, rng, yaw):
    identity = rng.standard_normal(20)
    truth, pose = landmarks_of(model, identity), rotation_of(yaw, 10, -15)
    fitter = LandmarkFitter(model, n_identity=20, n_expression=0, landmark_sd=0.001)
    fit = fitter.fit(seen(truth, pose))
    assert fit.converged and fit.n_iterations < 15
    assert fit.rms / SCALE < 0.005
    assert angle(fit.camera.rotation, pose) < 0.1
    assert fit.camera.scale == pytest.approx(SCALE, rel=1e-3)
    np.testing.assert_allclose(fit.identity, identity, atol=0.05)
    assert fit.expression is None
    assert distances(landmarks_of(model, fit.identity, fit.expression), truth).max() < 0.1


def test_expression_weights_come_back_with_the_face(model, rng):
    identity = 0.5 * rng.standard_normal(10)
    expression = expression_of(model, jawOpen=0.6, mouthSmileLeft=0.5, browInnerUp=0.7)
    truth, pose = landmarks_of(model, identity, expression), rotation_of(15, -5, 5)
    fitter = LandmarkFitter(model, n_identity=10, landmark_sd=0.01)
    fit = fitter.fit(seen(truth, pose))
    assert fit.converged
    np.testing.assert_allclose(fit.identity, identity, atol=0.3)
    fitted = landmarks_of(model, fit.identity, fit.expression)
    assert distances(fitted, truth).max() < 0.5
    # Most others have a near double: an open jaw is much like a mouth that closes less.
    inner_brow = model.expression_names.index("browInnerUp")
    assert fit.expression[inner_brow] == pytest.approx(0.7, abs=0.1)


def test_a_fit_projects_the_model_to_the_given_points(model, fitter, rng):
    pixels = seen(landmarks_of(model, rng.standard_normal(50)), rotation_of(30), 1, rng)
    fit = fitter.fit(pixels)
    vertices = model.shape(fit.identity, fit.expression)
    found = fit.camera.project(vertices[model.landmarks["ibug51"]])
    assert np.sqrt((distances(found, pixels) ** 2).mean()) == pytest.approx(fit.rms)
    np.testing.assert_allclose(fit.camera.rotation @ fit.camera.rotation.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(fit.camera.rotation) == pytest.approx(1)
    np.testing.assert_allclose(fit.camera.project(np.zeros(3)), fit.camera.translation)


def test_under_noise_residuals_stay_at_its_level_and_coefficients_within_the_prior(
    model, fitter, rng
):
    noise = 1.5  # mm, 1.7 % of the distance between the outer corners of the eyes
    rms, largest = [], []
    for yaw in np.linspace(-45, 45, 30):
        points = landmarks_of(model, rng.standard_normal(100))
        fit = fitter.fit(seen(points, rotation_of(yaw), noise, rng))
        assert fit.converged
        rms.append(fit.rms / fit.camera.scale)
        largest.append(np.abs(fit.identity).max())
    # Below the noise, of two coordinates, because some of it is explained away, but not all.
    assert 0.6 * noise * np.sqrt(2) < np.mean(rms) < noise * np.sqrt(2)
    assert max(largest) < 4


@pytest.mark.parametrize("yaw", [-45, 0, 45])
def test_the_pose_of_noisy_average_faces_is_found(model, fitter, rng, yaw):
    pose = rotation_of(yaw)
    points = landmarks_of(model, np.zeros(1))
    errors = [
        angle(fitter.fit(seen(points, pose, 0.9, rng)).camera.rotation, pose)  # 1 % of 90 mm
        for _ in range(10)
    ]
    assert np.mean(errors) < 2


def test_the_face_is_nearer_to_the_truth_than_the_mean_face(model, fitter, rng):
    ours, mean = [], []
    for yaw in np.linspace(-45, 45, 20):
        truth = landmarks_of(model, rng.standard_normal(100))
        fit = fitter.fit(seen(truth, rotation_of(yaw), 0.5, rng))
        truth = truth - truth.mean(0)
        for into, identity, expression in (
            (ours, fit.identity, fit.expression),
            (mean, np.zeros(1), None),
        ):
            found = landmarks_of(model, identity, expression)
            into.append(distances(found - found.mean(0), truth).mean())
    assert np.mean(ours) < 0.75 * np.mean(mean)


@pytest.mark.parametrize("weights", [{"jawOpen": 0.7}, {"mouthSmileLeft": 0.8}])
def test_an_expression_is_explained_by_expression_and_not_by_identity(model, fitter, weights):
    pixels = seen(landmarks_of(model, np.zeros(1), expression_of(model, **weights)), rotation_of())
    fit, neutral = fitter.fit(pixels), LandmarkFitter(model, n_expression=0).fit(pixels)
    assert np.linalg.norm(fit.identity) < 1 < 3 < np.linalg.norm(neutral.identity)
    assert fit.rms < neutral.rms / 5
    name, weight = next(iter(weights.items()))
    assert model.expression_names[fit.expression.argmax()] == name
    assert weight / 2 < fit.expression.max() < weight
    if name.endswith("Left"):
        other = model.expression_names.index(name.replace("Left", "Right"))
        assert abs(fit.expression[other]) < weight / 5


def test_the_size_of_the_image_changes_scale_and_translation_only(model, fitter, rng):
    pixels = seen(landmarks_of(model, rng.standard_normal(50)), rotation_of(20), 1, rng)
    small, large = fitter.fit(pixels), fitter.fit(10 * pixels + 1000)
    np.testing.assert_allclose(large.identity, small.identity, atol=1e-6)
    np.testing.assert_allclose(large.expression, small.expression, atol=1e-6)
    np.testing.assert_allclose(large.camera.rotation, small.camera.rotation, atol=1e-6)
    assert large.camera.scale == pytest.approx(10 * small.camera.scale)
    shift = large.camera.translation - 10 * small.camera.translation
    np.testing.assert_allclose(shift, 1000, rtol=1e-6)
    assert large.rms == pytest.approx(10 * small.rms)


def test_at_the_fit_every_coefficient_balances_prior_against_residuals(model, rng):
    truth, pose = landmarks_of(model, rng.standard_normal(100)), rotation_of(-30, 10)
    pixels = seen(truth, pose, 1.5, rng)
    fit = LandmarkFitter(model, tolerance=1e-12).fit(pixels)
    assert fit.converged and fit.n_iterations < 25
    landmarks = model.landmarks["ibug51"]
    shape = landmarks_of(model, fit.identity, fit.expression)
    residuals = (pixels - fit.camera.project(shape)) / fit.camera.scale
    basis = np.concatenate(
        [model.identity_basis_times_sd[:100, landmarks], model.expression_basis[:, landmarks]]
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


def test_more_steps_never_make_a_worse_fit_however_far_the_model_is(model):
    rng = np.random.default_rng(2)
    pixels = seen(landmarks_of(model, rng.standard_normal(100)), rotation_of(50), 3, rng)
    fits = [
        LandmarkFitter(
            model, n_identity=30, n_expression=0, landmark_sd=0.001, max_iterations=n
        ).fit(pixels)
        for n in range(1, 40)
    ]
    rms = np.array([fit.rms for fit in fits])
    assert (np.diff(rms) <= 0).all()
    assert rms[-1] < 0.8 * rms[0]
    assert not fits[0].converged and fits[-1].converged


def test_a_wider_prior_of_expressions_gives_larger_weights(model):
    pixels = seen(
        landmarks_of(model, np.zeros(1), expression_of(model, jawOpen=0.7)), rotation_of()
    )
    narrow, default, wide = (
        np.linalg.norm(LandmarkFitter(model, expression_sd=sd).fit(pixels).expression)
        for sd in (0.05, None, 1.0)
    )
    assert narrow < default < wide


def test_components_without_names_are_taken_for_principal_components(model, rng):
    pixels = seen(landmarks_of(model, rng.standard_normal(50)), rotation_of(), 2, rng)
    unnamed = dataclasses.replace(model, expression_names=())
    implied, wide, named = (
        LandmarkFitter(a_model, expression_sd=sd).fit(pixels).expression
        for a_model, sd in ((unnamed, None), (model, 1.0), (model, None))
    )
    np.testing.assert_array_equal(implied, wide)
    assert np.abs(implied - named).max() > 0.01


def test_a_mean_expression_of_the_model_is_part_of_the_face(model, rng):
    offset = np.array([0.0, 0.0, 30.0]) * (model.mean[:, 2:] > 110)
    shifted = dataclasses.replace(model, expression_mean=offset)
    truth, pose = (
        landmarks_of(model, np.zeros(1)) + offset[model.landmarks["ibug51"]],
        rotation_of(40),
    )
    assert LandmarkFitter(shifted).fit(seen(truth, pose)).rms < 1e-6
    assert LandmarkFitter(model).fit(seen(truth, pose)).rms > 1
    assert LandmarkFitter(shifted, n_expression=0).fit(seen(truth, pose)).rms > 1


def test_as_many_components_are_fitted_as_asked_for_or_there_are(model, rng):
    pixels = seen(landmarks_of(model, rng.standard_normal(50)), rotation_of(), 1, rng)
    fit = LandmarkFitter(model, n_identity=7, n_expression=5).fit(pixels)
    assert (len(fit.identity), len(fit.expression)) == (7, 5)
    fit = LandmarkFitter(model, n_identity=1000, n_expression=1000).fit(pixels)
    assert (len(fit.identity), len(fit.expression)) == (199, 51)
    without = dataclasses.replace(model, expression_basis=None, expression_names=())
    assert LandmarkFitter(without).fit(pixels).expression is None


def test_a_single_step_says_that_it_has_not_converged(model, rng):
    pixels = seen(landmarks_of(model, 2 * rng.standard_normal(50)), rotation_of(40), 1, rng)
    fit = LandmarkFitter(model, max_iterations=1).fit(pixels)
    assert not fit.converged and fit.n_iterations == 1
    assert fit.rms > LandmarkFitter(model).fit(pixels).rms


def test_the_mean_face_itself_needs_no_change(model, fitter):
    pose = rotation_of(30, 5)
    fit = fitter.fit(seen(landmarks_of(model, np.zeros(1)), pose))
    assert fit.converged and fit.rms < 1e-9
    np.testing.assert_allclose(fit.identity, 0, atol=1e-9)
    np.testing.assert_allclose(fit.camera.rotation, pose, atol=1e-9)
    np.testing.assert_allclose(fit.camera.translation, SHIFT, atol=1e-6)


def test_points_that_cannot_be_a_face_are_refused(model, fitter):
    pixels = seen(landmarks_of(model, np.zeros(1)), rotation_of())
    missing = pixels.copy()
    missing[3, 1] = np.nan
    for points, message in (
        (missing, "points must be finite"),
        (pixels[:-1], r"must be \(51, 2\). Received \(50, 2\)"),
        (pixels[None], r"must be \(51, 2\). Received \(1, 51, 2\)"),
        (np.ones((51, 2)), "spread in two directions. Received 0 by 0"),
        (pixels[:, :1] * (1, 0.5), "spread in two directions"),
        (pixels * (1, -1), "seen from in front, x to the right and y up"),
        (pixels * (-1, 1), "seen from behind or mirrored"),
    ):
        with pytest.raises(InputError, match=message):
            fitter.fit(points)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scheme": "ibug17"}, "scheme must be one of bfm72, ibug68, ibug51 .* 'ibug17'"),
        ({"n_identity": 0}, "n_identity and max_iterations must be at least 1"),
        ({"n_expression": -1}, "n_expression not negative"),
        ({"max_iterations": 0}, "max_iterations must be at least 1"),
        ({"landmark_sd": 0.0}, "landmark_sd and tolerance must be positive"),
        ({"expression_sd": -1.0}, "expression_sd, landmark_sd and tolerance must be positive"),
        ({"tolerance": 0.0}, "tolerance must be positive"),
    ],
)
def test_options_out_of_range_are_refused(model, options, message):
    with pytest.raises(InputError, match=message):
        LandmarkFitter(model, **options)
