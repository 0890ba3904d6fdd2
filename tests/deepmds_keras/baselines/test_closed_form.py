"""Mean, ridge regression and the two fits of Aldrian and Smith: exact cases, eos, bad input."""

import pickle

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sklearn.base import clone
from sklearn.exceptions import NotFittedError

from deepmds_keras.baselines import closed_form
from deepmds_keras.baselines.closed_form import Aldrian, AldrianAuthors, MeanShape, RidgeRegression
from deepmds_keras.errors import InputError
from deepmds_keras.geometry.camera import affine_cameras

L, K = 20, 4


@pytest.fixture
def model(rng):
    """Mean and basis of a small morphable model, in millimetres."""
    return rng.normal(0, 40, (L, 3)), rng.normal(0, 4, (K, L, 3))


@pytest.fixture
def shapes(model, rng):
    return model[0] + np.einsum("nk,kld->nld", rng.standard_normal((6, K)), model[1])


def turned(shapes, yaw, pitch=0.0):
    """Shapes in the frame of a camera, where the face is turned by these degrees."""
    return shapes @ Rotation.from_euler("yx", [yaw, pitch], degrees=True).as_matrix().T


def test_linear_recovers_an_exactly_linear_map(rng):
    truth, views = rng.normal(size=(10, 15)), rng.random((200, 5, 2))
    shapes = (views.reshape(200, 10) @ truth + 0.3).reshape(200, 5, 3)
    ridge = RidgeRegression().fit(views[:150], shapes[:150])
    np.testing.assert_allclose(ridge.predict(views[150:]), shapes[150:], atol=1e-3)
    assert ridge.n_parameters == 10 * 15 + 15 and ridge.ridge_.alpha_ < 1e-4


def test_roll_aligned_regression_does_not_depend_on_place_size_and_roll(model, rng):
    shapes = model[0] + np.einsum("nk,kld->nld", rng.standard_normal((200, K)), model[1])
    aligned = RidgeRegression(roll_aligned=True).fit(shapes[..., :2], shapes)
    roll = Rotation.from_euler("z", 50, degrees=True).as_matrix()[:2, :2]
    moved = 3 * shapes[..., :2] @ roll + [100, 7]
    np.testing.assert_allclose(aligned.predict(moved), aligned.predict(shapes[..., :2]), atol=1e-6)
    assert np.abs(aligned.predict(moved) - shapes).mean() < 1


@pytest.mark.parametrize("yaw", [-45, 0, 45])
def test_aldrian_recovers_the_shapes_of_exact_views(model, shapes, yaw):
    views = turned(shapes, yaw, pitch=10)[..., :2]
    predicted = Aldrian(*model, view_noise=1e-5, max_iter=2000, tol=1e-9).predict(views)
    np.testing.assert_allclose(predicted, shapes, atol=0.02)


def test_aldrian_shrinks_to_the_mean_as_noise_grows(model, shapes):
    offsets = [
        Aldrian(*model, view_noise=noise).predict(shapes[..., :2]) - model[0]
        for noise in (1e-2, 1e-1, 1.0, 1e3)
    ]
    assert (np.diff(list(map(np.linalg.norm, offsets))) < 0).all()
    np.testing.assert_allclose(offsets[-1], 0, atol=1e-3)


@pytest.mark.parametrize("method", [Aldrian, lambda *model: AldrianAuthors(*model, np.ones(K))])
def test_fits_ignore_scale_place_and_the_other_faces(model, shapes, method, monkeypatch):
    views = turned(shapes, 30)[..., :2]
    fit = clone(method(*model))
    batch = fit.predict(views)
    np.testing.assert_allclose(fit.predict(0.1 * views + [5, -3]), batch, atol=1e-3)
    alone = np.stack([fit.predict(view) for view in views])
    np.testing.assert_allclose(alone, batch, atol=1e-8)
    monkeypatch.setattr(closed_form, "CHUNK", 4)
    np.testing.assert_allclose(fit.predict(views), batch, atol=1e-8)
    assert fit.n_parameters == 0


def test_authors_fit_gives_every_face_coefficients_of_one_size(model, shapes):
    sd = np.array([3.0, 2.0, 1.0, 0.5])
    basis = model[1] * sd[:, None, None]
    predicted = AldrianAuthors(model[0], basis, sd).predict(turned(shapes, 30)[..., :2])
    offsets = (predicted - model[0]).reshape(len(shapes), -1)
    coefficients = np.linalg.lstsq(basis.reshape(K, -1).T, offsets.T)[0].T
    np.testing.assert_allclose(coefficients @ basis.reshape(K, -1), offsets, atol=1e-6)
    np.testing.assert_allclose(coefficients.mean(1), 0, atol=1e-9)
    np.testing.assert_allclose(coefficients.std(1, ddof=1), 1, rtol=1e-6)


@pytest.mark.parametrize("k", [K, 2 * L + 5])  # fewer and more than the coordinates of a view
@pytest.mark.parametrize(("regularisation", "noise"), [(0.5, 1.0), (0.5, 5.0), (30.0, 5.0)])
def test_shape_solve_agrees_with_eos(rng, regularisation, noise, k):
    """Eos is an independent implementation in C++."""
    eos = pytest.importorskip("eos", reason="needs eos-py", exc_type=ImportError)
    mean, variances = rng.normal(0, 40, (L, 3)), np.linspace(30, 5, k) ** 2
    basis = np.linalg.qr(rng.normal(size=(3 * L, k)))[0]
    times_sd = (basis * np.sqrt(variances)).T.reshape(k, L, 3)
    shapes = mean + np.tensordot(rng.standard_normal((4, k)), times_sd, 1)
    camera = np.array([[2.0, 0.1, -0.4, 250], [0.2, 1.9, 0.3, 240]])
    views = shapes @ camera[:, :3].T + camera[:, 3] + rng.normal(0, 2, (4, L, 2))
    cameras = affine_cameras(views, np.stack([mean] * 4))
    known = views, mean, times_sd, noise**2 * regularisation
    ours = closed_form.solve_shape(cameras, *known, closed_form.inner_products(times_sd))
    pca = eos.morphablemodel.PcaModel(
        np.float32(mean.ravel()), np.float32(basis), np.float32(variances), [[0, 1, 2]]
    )
    for view, camera, coefficients in zip(views, cameras, ours, strict=True):
        # Positional arguments, since the weight is called `lambda`; an empty base face is the mean.
        matrix, points = np.vstack([camera, [0, 0, 0, 1]]), [np.float32(point) for point in view]
        expected = eos.fitting.fit_shape_to_landmarks_linear(
            pca, np.float32(matrix), points, list(range(L)), np.float32([]), regularisation, None,
            noise, 0.0,
        )  # fmt: skip
        np.testing.assert_allclose(coefficients, expected, rtol=1e-4, atol=5e-4)  # float32


@pytest.mark.parametrize("method", [MeanShape(), RidgeRegression(alphas=(1e6,))])
def test_mean_is_the_answer_without_information_and_bad_faces_are_refused(method, rng):
    views, shapes = rng.random((5, L, 2)), rng.random((5, L, 3))
    message = f"This {type(method).__name__} is not trained"
    with pytest.raises(NotFittedError, match=message) as refused:
        clone(method).predict(views)
    again = pickle.loads(pickle.dumps(refused.value))  # as from a process of its own
    assert isinstance(again, NotFittedError) and str(again) == str(refused.value)
    with pytest.raises(InputError, match="views and shapes must have the same faces"):
        method.fit(views, shapes[:3])
    method.fit(views, shapes)
    np.testing.assert_allclose(method.predict(views), np.stack([shapes.mean(0)] * 5), atol=1e-4)
    np.testing.assert_allclose(method.predict(views[0]), shapes.mean(0), atol=1e-4)
    with pytest.raises(InputError, match=r"views must have 20 landmarks per face. Received 19"):
        method.predict(views[:, 1:])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"view_noise": 0.0}, "view_noise must be finite and positive"),
        ({"max_iter": 0.5}, "max_iter must be a whole number of at least 1"),
        ({"tol": np.nan}, "tol must be finite and not negative"),
        ({"basis_times_sd": np.full((K, L, 3), "a")}, "basis_times_sd must hold numbers"),
        ({"basis_times_sd": np.ma.masked_equal(np.eye(20, 3)[None], 1)}, "_sd must be finite, of"),
        ({"basis_times_sd": np.ones((4, 7, 3))}, r"basis_times_sd must be finite, of shape"),
        ({"basis_times_sd": 3.0}, r"must be finite, .* Received shape \(\)"),
        ({"mean": np.random.default_rng(1).random((2, 20, 3))}, "mean must be one face"),
        ({"mean": np.arange(60.0).reshape(20, 3)}, "mean must not be degenerate: .* on one line"),
        ({"mean": np.random.default_rng(1).random((20, 3)) * [1, 1, 0]}, "must not be flat"),
    ],
)
def test_the_unusable_option_is_named(model, options, message, rng):
    with pytest.raises(InputError, match=message):
        Aldrian(*model).set_params(**options).predict(rng.random((2, L, 2)))


@pytest.mark.parametrize("alphas", [(), (1.0, -1.0), (0.0,), (np.nan,), 1.0, np.ones((2, 2))])
def test_a_fit_that_fails_leaves_the_one_before(alphas, rng):
    views, shapes = rng.random((9, L, 2)), rng.random((9, L, 3))
    ridge = RidgeRegression(roll_aligned=True).fit(views, shapes)
    predicted = ridge.predict(views)
    with pytest.raises(InputError, match="alphas must be one or more finite and positive"):
        ridge.set_params(alphas=alphas).fit(views[:, :7], shapes[:, :7])
    assert np.array_equal(ridge.predict(views), predicted)


@pytest.mark.parametrize("sd", [np.ones(K - 1), [1, 2, 0, 4], [1, 2, np.inf, 4], 2.0])
def test_the_authors_fit_needs_an_sd_of_each_component(model, sd, rng):
    with pytest.raises(InputError, match="sd must be 4 finite and positive numbers. Received"):
        AldrianAuthors(*model, sd).predict(rng.random((2, L, 2)))


def test_one_component_is_too_few_for_the_authors_fit_alone(model, rng):
    (mean, basis), views = model, rng.random((2, L, 2))
    with pytest.raises(InputError, match="basis_times_sd must be finite, .*components >= 2"):
        AldrianAuthors(mean, basis[:1], np.ones(1)).predict(views)
    assert np.isfinite(Aldrian(mean, basis[:1]).predict(views)).all()
