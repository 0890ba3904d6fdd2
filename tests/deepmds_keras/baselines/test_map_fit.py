"""The fit of a known face model: exact views, an independent optimiser, missing landmarks."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from deepmds_keras.baselines import map_fit
from deepmds_keras.baselines.map_fit import MapFit
from deepmds_keras.errors import InputError

L, K, N = 30, 5, 7
pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture
def rng():
    return np.random.default_rng(1)


@pytest.fixture
def model(rng):
    """Mean and basis of a small morphable model, in millimetres, away from its origin."""
    return rng.normal([10, 0, 90], [50, 60, 30], (L, 3)), rng.normal(0, 3, (K, L, 3))


@pytest.fixture
def shapes(model, rng):
    return model[0] + np.tensordot(rng.standard_normal((N, K)), model[1], 1)


def views_of(shapes, mean, perspective, angles=(25, -10, 15)):
    """Seen by a camera whose inverse distance is so much of the mean's radius."""
    radius = np.sqrt(((mean - mean.mean(0)) ** 2).sum(1).mean())
    turn = Rotation.from_euler("yxz", angles, degrees=True).as_matrix()
    posed = (shapes - mean.mean(0)) @ turn.T / radius
    return 3 * posed[..., :2] / (1 - perspective * posed[..., 2:]) + [7, -2]


@pytest.mark.parametrize("perspective", [0.0, 0.1, 0.3])
def test_shapes_of_exact_views_are_recovered_from_any_distance(model, shapes, perspective):
    predicted = MapFit(*model).predict(views_of(shapes, model[0], perspective))
    np.testing.assert_allclose(predicted, shapes, atol=0.05)


def test_no_optimiser_finds_a_more_probable_shape(model, shapes, rng):
    mean, basis = model
    views = views_of(shapes, mean, 0.15)
    sd, prior = 0.05, (0.1, 0.05)
    views += rng.normal(0, sd, views.shape)
    predicted = MapFit(mean, basis, perspective=prior).predict(views, sd)
    radius = np.sqrt(((mean - mean.mean(0)) ** 2).sum(1).mean())

    def residuals(unknown, view):
        code, turn, scale, perspective, shift = np.split(unknown, [K, K + 3, K + 4, K + 5])
        shape = (mean - mean.mean(0) + np.tensordot(code, basis, 1)) / radius
        posed = shape @ Rotation.from_rotvec(turn).as_matrix().T
        seen = scale * posed[:, :2] / (1 - perspective * posed[:, 2:]) + shift
        return np.r_[(view - seen).ravel() / sd, code, (perspective - prior[0]) / prior[1]]

    for view, shape in zip(views, predicted, strict=True):
        start = np.r_[np.zeros(K), 0.1, 0.4, 0.2, 3, prior[0], view.mean(0)]
        found = least_squares(residuals, start, args=(view,), xtol=1e-12, ftol=1e-12)
        best = mean + np.tensordot(found.x[:K], basis, 1)
        np.testing.assert_allclose(shape, best, atol=0.02)


def test_views_of_which_the_mean_shape_explains_nothing_are_fitted():
    """Of a thin mean, seen from its end, the best scale is nothing."""
    rng = np.random.default_rng(2)
    mean, basis = 1e-3 * rng.standard_normal((L, 3)), rng.normal(0, 30, (60, L, 3))
    mean[:, 2] = np.linspace(-1, 1, L)
    shapes = mean + np.tensordot(rng.standard_normal((400, 60)), basis, 1)
    turns = Rotation.random(400, rng).as_matrix()
    views = (shapes @ np.swapaxes(turns, 1, 2))[..., :2]
    assert np.isfinite(MapFit(mean, basis, perspective=(0, 1e-3)).predict(views)).all()


def test_scale_place_roll_and_the_other_faces_do_not_matter(model, shapes, rng, monkeypatch):
    views = views_of(shapes, model[0], 0.1) + rng.normal(0, 0.02, (N, L, 2))
    views[:, 3] = np.nan
    views[2, 10:20] = np.nan
    fit = MapFit(*model)
    batch = fit.predict(views, 0.02)
    turn = Rotation.from_euler("z", 40, degrees=True).as_matrix()[:2, :2]
    np.testing.assert_allclose(fit.predict(50 * views @ turn + 9, 1.0), batch, atol=1e-2)
    alone = np.stack([fit.predict(view, 0.02) for view in views])
    np.testing.assert_allclose(alone, batch, atol=1e-6)
    monkeypatch.setattr(map_fit, "CHUNK", 3)
    np.testing.assert_allclose(fit.predict(views, np.full(N, 0.02)), batch, atol=1e-6)


def test_missing_landmarks_are_those_of_the_shape_that_the_others_show(model, shapes):
    views = views_of(shapes, model[0], 0.1)
    views[:, ::3] = np.nan
    np.testing.assert_allclose(MapFit(*model).predict(views), shapes, atol=0.1)


def test_the_more_noise_the_nearer_the_mean(model, shapes):
    views = views_of(shapes, model[0], 0.1)
    off = [np.abs(MapFit(*model).predict(views, sd) - model[0]).mean() for sd in (0, 0.3, 3, 300)]
    assert (np.diff(off) < 0).all() and off[-1] < 1e-3


@pytest.mark.parametrize(
    ("options", "arguments", "message"),
    [
        ({"perspective": (0, 0)}, (), "perspective must be a finite mean and a positive s.d."),
        ({"perspective": (np.nan, 0.1)}, (), "perspective must be a finite mean"),
        ({"mean": np.random.default_rng(1).random((L, 3)) * [1, 1, 0]}, (), "must not be flat"),
        ({"basis_times_sd": np.ones((0, L, 3))}, (), "basis_times_sd must be finite, of shape"),
        ({}, (-1.0,), "landmark_sd must be finite and not negative"),
        ({}, (np.ones(3),), "landmark_sd must be one number"),
    ],
)
def test_bad_input_is_refused(model, shapes, options, arguments, message):
    views = views_of(shapes, model[0], 0.1)
    with pytest.raises(InputError, match=message):
        MapFit(*model).set_params(**options).predict(views, *arguments)
    with pytest.raises(InputError, match="views must have shape"):
        MapFit(*model).predict(views[:, 1:])
