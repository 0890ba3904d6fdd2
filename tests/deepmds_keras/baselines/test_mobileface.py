"""MobileFace: the published size, the authors' weights, the loss, and training that goes on."""

import keras
import numpy as np
import pytest
from places import SHARED

from deepmds_keras import InputError
from deepmds_keras.baselines.mobileface import MobileFace, build_mobileface_net
from deepmds_keras.metrics import mse

RELEASED = SHARED / "released" / "bfm"
K, L, V = 4, 5, 30


@pytest.fixture(scope="module")
def toy():
    """Images in which each coefficient is the brightness of a quarter, and their faces."""
    rng = np.random.default_rng(0)
    basis = rng.normal(0, 1, (K, V, 3)) * np.array([8, 4, 2, 1])[:, None, None]
    coefficients = rng.standard_normal((64, K))
    bright = np.uint8((128 + 40 * coefficients).clip(0, 255))
    images = np.zeros((64, 96, 96, 3), np.uint8)
    for k, (row, column) in enumerate(((0, 0), (0, 48), (48, 0), (48, 48))):
        images[:, row : row + 48, column : column + 48] = bright[:, k, None, None, None]
    return images, coefficients, basis


def toy_model(basis, **options):
    flat = basis.reshape(K, -1)
    options = {"epochs": 2, "steps_per_epoch": 3, "batch_size": 8} | options
    return MobileFace(np.ones((L, 3)), basis[:, :L], flat @ flat.T / flat.shape[1], **options)


def test_size_is_the_published_one():
    net = build_mobileface_net()
    trainable = sum(int(np.prod(weight.shape)) for weight in net.trainable_weights)
    assert (trainable, net.count_params()) == (900_979, 907_819)
    assert net.output_shape == (None, 199)


def test_seed_sets_every_initial_weight():
    nets = [build_mobileface_net(K, seed=seed) for seed in (1, 1, 2)]
    first, again, other = ([w.numpy() for w in net.weights] for net in nets)
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    kernels = [a.ndim > 1 for a in first]
    assert [not np.array_equal(a, b) for a, b in zip(first, other, strict=True)] == kernels


@pytest.mark.skipif(not RELEASED.is_dir(), reason="the authors' weights (../shared) are absent")
def test_the_authors_weights_give_what_they_gave():
    with np.load(RELEASED / "oracle.npz") as file:
        oracle = dict(file)
    model = MobileFace(np.zeros((72, 3)), np.zeros((199, 72, 3)))
    model.load_released(RELEASED / "deep_mobileface_occ.h5")
    images = np.rint((oracle["images"] + 1) * 127.5)
    assert np.abs(images / 127.5 - 1 - oracle["images"]).max() < 1 / 255
    raw = np.asarray(model.network_(oracle["images"], training=False))
    assert np.abs(raw - oracle["mobileface_raw"]).max() < 1e-4
    coefficients = model.coefficients(np.uint8(images))
    # Through uint8, the images differ by half a grey level.
    spread = np.abs(oracle["mobileface_coefficients"]).max()
    assert np.abs(coefficients - oracle["mobileface_coefficients"]).max() < 0.02 * spread
    # What the network gives is standardised over one face, also where two are given.
    standardised = (raw - raw.mean(1, keepdims=True)) / raw.std(1, keepdims=True)
    assert np.abs(standardised - oracle["mobileface_coefficients"]).max() < 1e-5
    assert model.n_parameters == 900_979


@pytest.mark.parametrize("standardise", ["face", "batch"])
def test_loss_is_the_mean_squared_error_of_the_meshes(toy, standardise):
    _, coefficients, basis = toy
    raw = np.random.default_rng(1).normal(2, 3, (64, K))
    axis = 1 if standardise == "face" else None
    used = (raw - raw.mean(axis, keepdims=True)) / raw.std(axis, keepdims=True)
    meshes = [np.tensordot(c, basis, 1) for c in (used, coefficients)]
    loss = toy_model(basis, standardise=standardise)._loss()
    found = loss(np.float32(coefficients), np.float32(raw))
    assert np.allclose(found, mse(*meshes), rtol=1e-4)


@pytest.mark.slow
def test_training_learns_and_predictions_are_in_the_models_frame(toy):
    images, coefficients, basis = toy
    # In half as many epochs it is the processor's rounding that decides.
    model = toy_model(basis, epochs=6, steps_per_epoch=20)
    model.fit(images, coefficients)
    assert model.history_["train"][-1] < 0.7 * model.history_["train"][0]
    shapes = model.predict(images[:7])
    found = model.coefficients(images[:7])
    assert np.allclose(found.mean(1), 0, atol=1e-5)
    assert np.allclose(found.std(1), 1, atol=1e-4)
    assert np.allclose(shapes, 1 + np.tensordot(found, basis[:, :L], 1), atol=1e-4)


@pytest.mark.slow
def test_stopped_training_goes_on_to_the_same_weights(toy, tmp_path):
    images, coefficients, basis = toy
    whole = toy_model(basis).fit(images, coefficients)

    def stop(losses):
        raise KeyboardInterrupt

    path = tmp_path / "mobileface.npz"
    with pytest.raises(KeyboardInterrupt):
        toy_model(basis).fit(images, coefficients, checkpoint=path, progress=stop)
    with pytest.raises(InputError, match="mobileface.npz is not trained to the end. Received 1 of"):
        toy_model(basis).restore(path)
    seen = []
    resumed = toy_model(basis).fit(images, coefficients, checkpoint=path, progress=seen.append)
    assert len(seen) == 2
    assert resumed.history_ == whole.history_
    restored = toy_model(basis).restore(path)
    for weights in zip(*(m.network_.weights for m in (whole, resumed, restored)), strict=True):
        assert np.array_equal(weights[0].numpy(), weights[1].numpy())
        assert np.array_equal(weights[0].numpy(), weights[2].numpy())
    with pytest.raises(InputError, match="mobileface.npz is of another run"):
        toy_model(basis, seed=5).fit(images, coefficients, checkpoint=path)


@pytest.mark.parametrize(
    "images",
    [
        np.zeros((1, 96, 96, 3), np.float32),
        np.zeros((1, 96, 96, 4), np.uint8),
        np.zeros((1, 96, 96), np.uint8),
        np.zeros((1, 95, 96, 3), np.uint8),
        np.zeros((0, 96, 96, 3), np.uint8),
    ],
)
def test_images_of_another_kind_are_refused(toy, images):
    model = toy_model(toy[2])
    with pytest.raises(InputError, match="call fit, restore or load_released first"):
        model.predict(images)
    model.network_ = keras.Sequential([keras.Input((96, 96, 3)), keras.layers.Flatten()])
    with pytest.raises(InputError, match=r"images must be uint8 of shape .* Received"):
        model.predict(images)


def test_unusable_training_data_are_refused(toy, tmp_path):
    images, coefficients, basis = toy
    with pytest.raises(InputError, match=r"coefficients must have shape \(64, 4\)"):
        toy_model(basis).fit(images, coefficients[:5])
    with pytest.raises(InputError, match="shape_gram must have shape"):
        MobileFace(np.ones((L, 3)), basis[:, :L]).fit(images, coefficients)
    with pytest.raises(InputError, match="standardise must be one of face, batch"):
        toy_model(basis, standardise="row").fit(images, coefficients)
    path = tmp_path / "weights.h5"
    path.write_bytes(b"no HDF5")
    with pytest.raises(InputError, match="weights.h5 must be a Keras 2 weight file"):
        toy_model(basis).load_released(path)
