import subprocess
import sys

import numpy as np
import pytest
from sklearn.base import clone

from deepmds_keras.alignment import align
from deepmds_keras.baselines.aldrian import Aldrian, solve_shape
from deepmds_keras.baselines.aldrian_authors import AldrianAuthors
from deepmds_keras.baselines.linear import Linear
from deepmds_keras.baselines.mean_shape import MeanShape
from deepmds_keras.baselines.zhao import Zhao, build_zhao_net, normalise_view
from deepmds_keras.errors import InputError
from deepmds_keras.normalisation import normalise

N_LANDMARKS, N_COMPONENTS = 20, 4


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture
def model(rng):
    """Mean and basis of a small morphable model, in millimetres."""
    mean = rng.normal(0, 40, (N_LANDMARKS, 3))
    return mean, rng.normal(0, 4, (N_COMPONENTS, N_LANDMARKS, 3))


@pytest.fixture
def faces(model, rng):
    """Coefficients and shapes of a few faces."""
    mean, basis = model
    coefficients = rng.standard_normal((6, N_COMPONENTS))
    return coefficients, mean + np.einsum("nk,kld->nld", coefficients, basis)


def turned(shapes, yaw, pitch=0.0):
    """Shapes in the frame of a camera that the face turns to by yaw, then pitch, in degrees."""
    (cy, cp), (sy, sp) = np.cos(np.deg2rad([yaw, pitch])), np.sin(np.deg2rad([yaw, pitch]))
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_x = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    return shapes @ (about_x @ about_y).T


def quick_zhao(**options):
    return Zhao(**{"n_landmarks": N_LANDMARKS, "epochs": 2, "steps_per_epoch": 20, **options})


# Mean shape


def test_mean_shape_answers_every_view_with_the_mean(faces, rng):
    _, shapes = faces
    mean_shape = MeanShape().fit(shapes[..., :2], shapes)
    predicted = mean_shape.predict(rng.random((9, N_LANDMARKS, 2)))
    np.testing.assert_allclose(predicted, np.stack([shapes.mean(0)] * 9))
    assert mean_shape.n_parameters == N_LANDMARKS * 3


# Linear


def test_linear_recovers_an_exactly_linear_map(rng):
    truth = rng.normal(size=(10, 15))
    views = rng.random((200, 5, 2))
    shapes = (views.reshape(200, 10) @ truth + 0.3).reshape(200, 5, 3)
    linear = Linear().fit(views[:150], shapes[:150])
    np.testing.assert_allclose(linear.predict(views[150:]), shapes[150:], atol=1e-3)
    assert linear.n_parameters == 10 * 15 + 15
    assert linear.ridge_.alpha_ < 1e-4


def test_linear_shrinks_to_the_mean_where_views_say_nothing(rng):
    views, shapes = rng.random((100, 5, 2)), rng.random((100, 5, 3))
    linear = Linear(alphas=(1e-6, 1e6)).fit(views, shapes)
    assert linear.ridge_.alpha_ == 1e6
    np.testing.assert_allclose(linear.predict(views), MeanShape().fit(views, shapes).mean_[None]
                               .repeat(100, 0), atol=1e-4)  # fmt: skip


# Zhao


@pytest.mark.parametrize(("n_landmarks", "count"), [(72, 114_840), (51, 57_783)])
def test_zhao_has_the_papers_number_of_parameters(n_landmarks, count):
    network = build_zhao_net(n_landmarks)
    assert network.count_params() == count
    assert sum(np.prod(w.shape) for w in network.trainable_weights) == count
    assert (network.input_shape, network.output_shape) == (
        (None, 2 * n_landmarks),
        (None, n_landmarks),
    )


def test_zhao_unit_is_the_sum_of_the_standard_deviations(rng):
    views, size = normalise_view(rng.random((4, 30, 2)) * [3, 1])
    np.testing.assert_allclose(views.std(1).sum(1), 1)
    np.testing.assert_allclose(views.mean(1), 0, atol=1e-12)
    assert size.shape == (4, 1, 1)


def test_zhao_does_not_see_scale_and_place_of_a_view(faces):
    _, shapes = faces
    zhao = quick_zhao().fit(shapes)
    moved = 7.0 * shapes[..., :2] + [300, -20]
    np.testing.assert_allclose(
        zhao.predict(moved), zhao.predict(shapes[..., :2]), rtol=0, atol=1e-5
    )


def test_zhao_training_does_not_see_scale_and_place_of_a_face(faces):
    _, shapes = faces
    one, other = quick_zhao().fit(shapes), quick_zhao().fit(0.25 * shapes + [3, 4, 500])
    views = shapes[..., :2]
    np.testing.assert_allclose(one.predict(views), other.predict(views), rtol=0, atol=1e-4)


def test_zhao_learns_a_few_faces_by_heart_in_one_unit(faces):
    """The aligned shape is right only if depth has the unit of x and y."""
    _, shapes = faces
    zhao = quick_zhao(epochs=10, steps_per_epoch=200, learning_rate=3e-4).fit(shapes)
    predicted = zhao.predict(shapes[..., :2])
    aligned = align(predicted, shapes)
    spread = ((shapes - shapes.mean(1, keepdims=True)) ** 2).mean()
    assert ((aligned - shapes) ** 2).mean() < 5e-3 * spread
    assert zhao.history_["train"][-1] < 0.1 * zhao.history_["train"][0]


@pytest.mark.slow
def test_zhao_seed_decides_the_weights(faces):
    _, shapes = faces
    one, same, other = (quick_zhao(seed=seed).fit(shapes).network_ for seed in (1, 1, 2))
    for a, b, c in zip(one.get_weights(), same.get_weights(), other.get_weights(), strict=True):
        np.testing.assert_array_equal(a, b)
        assert not np.array_equal(a, c)


@pytest.mark.slow
def test_zhao_that_was_stopped_ends_as_one_that_was_not(faces, tmp_path):
    class StoppedError(Exception):
        pass

    def stop(_losses):
        raise StoppedError

    _, shapes = faces
    checkpoint = tmp_path / "zhao.npz"
    with pytest.raises(StoppedError):
        quick_zhao().fit(shapes, checkpoint=checkpoint, progress=stop)
    with pytest.raises(InputError, match="zhao.npz is not trained to the end"):
        quick_zhao().restore(checkpoint)
    resumed = quick_zhao().fit(shapes, checkpoint=checkpoint)
    views = shapes[..., :2]
    whole = quick_zhao().fit(shapes).predict(views)
    np.testing.assert_array_equal(resumed.predict(views), whole)
    np.testing.assert_array_equal(quick_zhao().restore(checkpoint).predict(views), whole)


def test_zhao_is_trained_by_the_optimiser_that_is_named(faces):
    _, shapes = faces
    views = shapes[..., :2]
    adam, rmsprop = (
        quick_zhao(optimizer=name).fit(shapes).predict(views) for name in ("adam", "rmsprop")
    )
    np.testing.assert_array_equal(adam, quick_zhao().fit(shapes).predict(views))
    assert np.abs(adam - rmsprop).max() > 1e-3
    with pytest.raises(InputError, match="optimizer must be one of adam, rmsprop. Received 'sgd'"):
        quick_zhao(optimizer="sgd").fit(shapes)


# Aldrian


@pytest.mark.parametrize("camera", ["affine", "orthographic"])
@pytest.mark.parametrize("yaw", [-45, 0, 45])
def test_aldrian_recovers_hidden_coefficients(model, faces, camera, yaw):
    coefficients, shapes = faces
    views = normalise(turned(shapes, yaw, pitch=10)[..., :2])
    aldrian = Aldrian(*model, camera=camera, view_noise=1e-5, max_iter=2000, tol=1e-9)
    found, cameras, rounds = aldrian.solve(views)
    np.testing.assert_allclose(found, coefficients, atol=1e-3)
    np.testing.assert_allclose(aldrian.predict(views), shapes, atol=0.02)
    seen = shapes @ np.swapaxes(cameras[..., :3], 1, 2) + cameras[:, None, :, 3]
    np.testing.assert_allclose(seen, views, atol=1e-4)
    assert rounds.max() < 2000


def test_aldrian_shrinks_to_the_mean_as_noise_grows(model, faces):
    views = normalise(faces[1][..., :2])
    sizes = [
        np.linalg.norm(Aldrian(*model, view_noise=noise).solve(views)[0])
        for noise in (1e-2, 1e-1, 1.0, 1e3)
    ]
    assert (np.diff(sizes) < 0).all()
    predicted = Aldrian(*model, view_noise=1e3).predict(views)
    np.testing.assert_allclose(predicted, np.stack([model[0]] * len(views)), atol=1e-3)


def test_aldrian_weighs_shape_noise_as_the_camera_sees_it(model, faces):
    """Under a scaled orthographic camera shape noise is view noise times the scale."""
    views = faces[1][:1, :, :2] / 200
    options = {"camera": "orthographic", "tol": 1e-9, "max_iter": 500}
    by_shape, cameras, _ = Aldrian(*model, view_noise=1e-9, shape_noise=3.0, **options).solve(views)
    noise = 3.0 * np.linalg.norm(cameras[0, 0, :3]) / np.ptp(views, axis=1).max()
    by_view, _, _ = Aldrian(*model, view_noise=noise, **options).solve(views)
    np.testing.assert_allclose(by_shape, by_view, atol=1e-5)


def test_aldrian_does_not_see_scale_and_place_of_a_view(model, faces):
    views = faces[1][..., :2]
    aldrian = Aldrian(*model)
    np.testing.assert_allclose(
        aldrian.predict(views), aldrian.predict(0.01 * views + [5, -3]), atol=1e-6
    )


def test_aldrian_batch_equals_one_by_one(model, faces, monkeypatch):
    views = turned(faces[1], 30)[..., :2]
    aldrian = Aldrian(*model)
    batch = aldrian.predict(views)
    for view, shape in zip(views, batch, strict=True):
        np.testing.assert_allclose(aldrian.predict(view)[0], shape, atol=1e-8)
    monkeypatch.setattr("deepmds_keras.baselines.aldrian.CHUNK", 4)
    np.testing.assert_allclose(aldrian.predict(views), batch, atol=1e-8)


def test_aldrian_solve_is_the_ridge_solution_of_the_stacked_system(model, rng):
    mean, basis = model
    camera, views = rng.normal(size=(3, 2, 4)), rng.normal(size=(3, N_LANDMARKS, 2))
    precision = rng.random((3, 2)) + 0.5
    found = solve_shape(camera, views, mean, basis, precision, 0.7)
    for face in range(3):
        weight = np.tile(np.sqrt(precision[face]), N_LANDMARKS)
        a = np.stack([(mode @ camera[face, :, :3].T).ravel() for mode in basis], axis=1)
        b = (mean @ camera[face, :, :3].T + camera[face, :, 3] - views[face]).ravel()
        rows = np.vstack([weight[:, None] * a, np.sqrt(0.7) * np.eye(N_COMPONENTS)])
        right = np.concatenate([-weight * b, np.zeros(N_COMPONENTS)])
        expected = np.linalg.lstsq(rows, right, rcond=None)[0]
        np.testing.assert_allclose(found[face], expected, rtol=1e-8)


def test_aldrian_trains_nothing(model):
    assert Aldrian(*model).n_parameters == 0


def test_aldrian_as_the_authors_ran_it_gives_every_face_coefficients_of_one_size(model, faces):
    sd = np.array([3.0, 2.0, 1.0, 0.5])
    basis = model[1] * sd[:, None, None]
    views = turned(faces[1], 30)[..., :2]
    shapes = AldrianAuthors(model[0], basis, sd).predict(views)
    offsets = (shapes - model[0]).reshape(len(views), -1)
    found = np.linalg.lstsq(basis.reshape(len(sd), -1).T, offsets.T, rcond=None)[0].T
    np.testing.assert_allclose(found @ basis.reshape(len(sd), -1), offsets, atol=1e-6)
    np.testing.assert_allclose(found.mean(1), 0, atol=1e-9)
    np.testing.assert_allclose(found.std(1, ddof=1), 1, rtol=1e-6)
    np.testing.assert_allclose(
        AldrianAuthors(model[0], basis, sd).predict(0.1 * views + [5, -3]), shapes, atol=1e-3
    )


# Bad input


def test_bad_input_is_named(model, rng):
    views, shapes = rng.random((5, N_LANDMARKS, 2)), rng.random((5, N_LANDMARKS, 3))
    for method in (MeanShape(), Linear()):
        with pytest.raises(InputError, match=f"This {type(method).__name__} is not trained"):
            method.predict(views)
        with pytest.raises(InputError, match="views and shapes must have the same faces"):
            method.fit(views, shapes[:3])
        with pytest.raises(InputError, match=r"views must have 20 landmarks a face. Received 19"):
            method.fit(views, shapes).predict(views[:, 1:])
    with pytest.raises(InputError, match="This Zhao is not trained"):
        quick_zhao().predict(views)
    with pytest.raises(InputError, match=r"points must have 20 landmarks a face. Received 19"):
        quick_zhao().fit(shapes[:, 1:])
    with pytest.raises(InputError, match="points must be finite"):
        quick_zhao().fit(np.where(shapes == shapes[2, 3, 1], np.nan, shapes))
    with pytest.raises(InputError, match=r"views must have 20 landmarks a face. Received 19"):
        Aldrian(*model).predict(views[:, 1:])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"camera": "pinhole"}, "camera must be one of affine, orthographic. Received 'pinhole'"),
        ({"view_noise": 0.0}, "view_noise must be positive"),
        ({"regularisation": -1.0}, "regularisation must be positive"),
        ({"max_iter": 0}, "max_iter must be positive"),
        ({"basis_times_sd": np.ones((4, 7, 3))}, r"basis_times_sd must be finite, of shape"),
        ({"mean": np.arange(60.0).reshape(20, 3)}, "mean must not be collinear"),
        ({"mean": np.random.default_rng(1).random((20, 3)) * [1, 1, 0]}, "must not be flat"),
    ],
)
def test_aldrian_names_the_unusable_option(model, options, message):
    mean, basis = model
    views = np.random.default_rng(0).random((2, N_LANDMARKS, 2))
    aldrian = Aldrian(mean, basis).set_params(**options)
    with pytest.raises(InputError, match=message):
        aldrian.predict(views)


# All of them


def test_methods_are_cloneable(model):
    for method in (MeanShape(), Linear(alphas=(1.0, 2.0)), quick_zhao(seed=3), Aldrian(*model)):
        assert str(clone(method).get_params()) == str(method.get_params())


def test_only_zhao_needs_tensorflow():
    code = (
        "import sys, deepmds_keras.baselines.aldrian, deepmds_keras.baselines.linear, "
        "deepmds_keras.baselines.mean_shape; sys.exit('tensorflow' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
