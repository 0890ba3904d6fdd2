"""Zhao's net, MobileFace and RingNet: sizes, losses, and trainings that go on where they were."""

import pickle

import keras
import numpy as np
import pytest
import tensorflow as tf
from keras import layers
from places import SHARED
from scipy.spatial.transform import Rotation
from sklearn.base import clone

from deepmds_keras import InputError, errors
from deepmds_keras.baselines.images import forward_images
from deepmds_keras.baselines.mlp import MLP, _flat
from deepmds_keras.baselines.mobileface import MobileFace, build_mobileface_net
from deepmds_keras.baselines.ringnet import (
    RingNet,
    RingNetLoss,
    build_ringnet,
    draw_rings,
    ring_loss,
)
from deepmds_keras.baselines.zhao import Zhao, build_zhao_net
from deepmds_keras.files import read_arrays, write_arrays
from deepmds_keras.geometry.alignment import align
from deepmds_keras.lifting.trainer import build_lifting_net
from deepmds_keras.lifting.unrolled_fit import initial_weights
from deepmds_keras.metrics import mse
from deepmds_keras.networks import count_trainable

RELEASED = SHARED / "released" / "bfm"
K, E, L, SIZE = 4, 2, 12, 32
rng = np.random.default_rng(0)
MEAN, EXPRESSIONS = rng.normal(0, 30, (L, 3)) + [0, 0, 90], rng.normal(0, 3, (E, L, 3))
BASIS = rng.normal(0, 1, (K, L, 3)) * np.array([8, 4, 2, 1])[:, None, None]
SUBJECTS = np.repeat(np.arange(6), 4)[rng.permutation(24)]
CODES = np.c_[rng.normal(size=(6, K))[SUBJECTS], rng.normal(size=(24, E))]
SHAPES = MEAN + np.tensordot(CODES, np.concatenate([BASIS, EXPRESSIONS]), 1)
VIEWS = SHAPES[..., :2]


@pytest.fixture(autouse=True)
def small_bodies(monkeypatch):
    """Bodies that compile at once; what follows them, and how they are trained, stays as it is."""

    def body(input_shape, **_):
        image = keras.Input(input_shape)
        x = layers.AveragePooling2D(image.shape[1] // 4, name="pool")(image)
        x = layers.Conv2D(16, 2, activation="relu", name="conv")(x)
        x = layers.BatchNormalization(name="conv_bn")(x)
        return keras.Model(image, layers.Flatten(name="flat")(x))

    for name in ("MobileNet", "ResNet50"):
        monkeypatch.setattr(keras.applications, name, body)


def images_of(codes, size):
    """Images in which each of four coefficients is the brightness of a quarter."""
    bright = np.uint8((128 + 40 * codes[:, :4]).clip(0, 255)).reshape(-1, 2, 2)
    quarters = bright.repeat(size // 2, axis=1).repeat(size // 2, axis=2)
    return quarters[..., None].repeat(3, axis=3)


def untrained(method, **options):
    """The method for the toy faces, what it is trained on, and what it predicts from."""
    options = {"epochs": 2, "steps_per_epoch": 3} | options
    if method == "zhao":
        return Zhao(L, **options), (SHAPES,), VIEWS
    if method == "mlp":
        return MLP(L, **options), (VIEWS, SHAPES / 100), VIEWS
    if method == "mobileface":
        gram, images = np.einsum("kld,mld->km", BASIS, BASIS) / (3 * L), images_of(CODES, 96)
        return MobileFace(MEAN, BASIS, gram, **options), (images, CODES[:, :K]), images
    options |= {"image_size": SIZE, "ring_size": 4, "rings_per_batch": 2}
    images, pixels = images_of(CODES, SIZE), SIZE / 2 + VIEWS * [0.2, -0.2]
    return RingNet(MEAN, BASIS, EXPRESSIONS, **options), (images, pixels, SUBJECTS), images


def test_numbers_of_parameters_are_the_published_ones(monkeypatch):
    monkeypatch.undo()  # the real bodies
    assert [build_zhao_net(n).count_params() for n in (72, 51)] == [114_840, 57_783]
    mobileface = build_mobileface_net()
    assert (count_trainable(mobileface), mobileface.count_params()) == (900_979, 907_819)
    resnet50, n = 23_587_712 - 53_120, 6 + K + E  # without classes and running averages
    regressor = (2048 + n) * 512 + 512 + 512 * 512 + 512 + 512 * n + n
    assert count_trainable(build_ringnet(K, E, SIZE)) == resnet50 + regressor


@pytest.mark.slow
@pytest.mark.parametrize("method", ["zhao", "mlp", "mobileface", "ringnet"])
def test_stopped_training_goes_on_to_the_same_weights(method, tmp_path):
    (whole, data, inputs), path = untrained(method), tmp_path / "net.npz"
    whole.fit(*data)
    with pytest.raises(ZeroDivisionError):
        clone(whole).fit(*data, checkpoint=path, progress=lambda losses: 1 / 0)
    resumed, seen = clone(whole), []
    with pytest.raises(InputError, match="net.npz is only partly trained: 1 of 2"):
        resumed.restore(path)
    with pytest.raises(InputError, match="is not trained: call fit or restore first"):
        resumed.predict(inputs)
    resumed.fit(*data, checkpoint=path, progress=seen.append)
    assert len(seen) == 2 and resumed.history_ == whole.history_
    restored = clone(whole).restore(path)
    assert restored.n_parameters == count_trainable(whole.network_)
    for model in (resumed, restored):
        for a, b in zip(whole.network_.weights, model.network_.weights, strict=True):
            np.testing.assert_array_equal(a.numpy(), b.numpy())
        np.testing.assert_array_equal(model.predict(inputs), whole.predict(inputs))
    other = untrained(method, seed=5)[0]
    kernels = [other._build(seed).trainable_weights[0].numpy() for seed in (5, 0)]
    assert not np.array_equal(*kernels)
    with pytest.raises(InputError, match="net.npz is from another run"):
        other.fit(*data, checkpoint=path)


@pytest.mark.parametrize("method", ["zhao", "mlp", "mobileface", "ringnet"])
def test_numbers_of_numpy_are_taken(method):
    model, data, inputs = untrained(method, epochs=1, steps_per_epoch=1)
    numpy = {int: np.int64, float: np.float32}
    given = {k: numpy[type(v)](v) for k, v in model.get_params().items() if type(v) in numpy}
    assert np.isfinite(model.set_params(**given).fit(*data).predict(inputs)).all()


# Keras itself, of its own variables.
@pytest.mark.filterwarnings("ignore:__array__ implementation")
@pytest.mark.parametrize("method", ["zhao", "mlp", "mobileface", "ringnet"])
def test_what_is_trained_is_unpickled_and_restored_only_with_its_parameters(method, tmp_path):
    (model, data, inputs), path = untrained(method, epochs=1, steps_per_epoch=1), tmp_path / "net"
    model.fit(*data, checkpoint=path)
    again = pickle.loads(pickle.dumps(model))
    np.testing.assert_array_equal(again.predict(inputs), model.predict(inputs))
    if method in ("zhao", "mlp"):
        other, needed = again.set_params(n_landmarks=L - 1), "n_landmarks must be 12, with which"
        with pytest.raises(InputError, match=needed):
            other.predict(inputs[:, 1:])
        return
    other = clone(model).set_params(landmark_mean=2 * MEAN)
    with pytest.raises(InputError, match="net is from another run.*Received .*landmark_mean"):
        other.restore(path)
    arrays, described = read_arrays(path)
    described["label"].pop("arrays", None)  # as in files of version 0.4
    write_arrays(path, arrays, described)
    other.restore(path)
    assert model.fit(*data, checkpoint=path).history_ == other.history_


@pytest.mark.parametrize(
    "use",
    [
        lambda: build_lifting_net(initial_weights(SHAPES.swapaxes(1, 2), 0)),
        lambda: untrained("mlp")[0]._build(),
        build_zhao_net,
        build_mobileface_net,
        lambda: build_ringnet(K, E, SIZE),
        lambda: forward_images(None, np.zeros((1, SIZE, SIZE, 3))),
    ],
)
def test_in_a_fork_of_a_process_that_used_keras_they_are_refused(use, monkeypatch):
    monkeypatch.setitem(errors._used_in, "Keras", -1)
    with pytest.raises(InputError, match="Keras cannot be used in a fork"):
        use()


@pytest.mark.parametrize("method", ["mobileface", pytest.param("ringnet", marks=pytest.mark.slow)])
def test_training_learns_and_predicts_in_the_face_models_frame(method):
    model, data, images = untrained(method, epochs=5, steps_per_epoch=50, learning_rate=3e-3)
    model.fit(*data)
    assert model.history_["train"][-1] < 0.6 * model.history_["train"][0]
    shapes = model.predict(images)
    np.testing.assert_allclose(model.predict(images[:2]), shapes[:2], atol=1e-3)
    bases = np.concatenate([BASIS, EXPRESSIONS][: 1 + (method == "ringnet")]).reshape(-1, 3 * L)
    offsets = (shapes - MEAN).reshape(24, -1)
    np.testing.assert_allclose(offsets, offsets @ np.linalg.pinv(bases) @ bases, atol=1e-3)
    for wrong in (np.float32(images), images[..., :2], images[0], images[:, 1:], images[:0]):
        with pytest.raises(InputError, match=r"images must be uint8 of shape .* Received"):
            model.predict(wrong)


def test_gradients_of_ringnet_are_sums_of_two_or_of_parts_that_do_not_overlap():
    # The last bit of TensorFlow's sum of three or more depends on the timing of threads. Those in
    # Keras's batch normalisation are left: two whole trainings ended with the same bits.
    model, network = untrained("ringnet")[0], build_ringnet(K, E, SIZE)
    loss = RingNetLoss(model, fill=0.6)

    @tf.function
    def gradients(images, landmarks):
        with tf.GradientTape() as tape:
            value = loss(landmarks, network(images, training=True))
        return tape.gradient(value, network.trainable_weights)

    inputs = (tf.TensorSpec(shape) for shape in ((24, SIZE, SIZE, 3), (24, 2 * L)))
    graph = gradients.get_concrete_function(*inputs).graph
    sums = [op for op in graph.get_operations() if op.type == "AddN" and len(op.inputs) > 2]
    added = [part.op for op in sums for part in op.inputs if "_bn" not in part.op.name]
    assert {op.type for op in added} == {"StridedSliceGrad"}


def test_zhao_learns_depth_in_the_unit_of_x_and_y_whatever_scale_and_place():
    options = {"epochs": 8, "steps_per_epoch": 200, "learning_rate": 3e-4}
    zhao = untrained("zhao", **options)[0].fit(0.25 * SHAPES + [3, 4, 500])
    predicted = zhao.predict(VIEWS)
    spread = ((SHAPES - SHAPES.mean(1, keepdims=True)) ** 2).mean()
    assert ((align(predicted, SHAPES) - SHAPES) ** 2).mean() < 0.01 * spread
    np.testing.assert_allclose(predicted[..., :2].std(1).sum(1), 1)
    np.testing.assert_allclose(zhao.predict(7.0 * VIEWS + [300, -20]), predicted, atol=1e-5)
    np.testing.assert_allclose(zhao.predict(VIEWS[3]), predicted[3], atol=1e-5)
    zhao.set_params(optimizer="rmsprop", epochs=1).fit(SHAPES)  # another optimiser, other weights
    assert np.abs(zhao.predict(VIEWS) - predicted).max() > 1e-3


def test_mlp_learns_shapes_whatever_scale_and_place_and_has_as_many_parameters():
    model, data, _ = untrained("mlp", epochs=5, steps_per_epoch=100)
    predicted = model.fit(*data).predict(7.0 * VIEWS + [300, -20])
    np.testing.assert_allclose(predicted, model.predict(VIEWS), atol=1e-5)
    np.testing.assert_allclose(predicted[3], model.predict(VIEWS[3]), atol=1e-5)
    errors = [((shapes - data[1]) ** 2).mean() for shapes in (predicted, data[1].mean(0))]
    assert errors[0] < 0.2 * errors[1]
    assert count_trainable(MLP()._build()) == 25_536
    standardised = model.network_.get_layer("standardised")(_flat(VIEWS)).numpy()
    np.testing.assert_allclose(standardised.mean(0), 0, atol=1e-4)
    np.testing.assert_allclose(standardised.std(0), 1, atol=1e-3)


@pytest.mark.skipif(not RELEASED.is_dir(), reason="the authors' weights (../shared) are absent")
def test_the_authors_mobileface_gives_what_it_gave(monkeypatch):
    monkeypatch.undo()
    oracle = np.load(RELEASED / "oracle.npz")
    model = MobileFace(np.zeros((199, 3)), np.eye(199)[..., None] * np.ones(3), np.eye(199))
    model.load_released(RELEASED / "deep_mobileface_occ.h5")
    raw = np.asarray(model.network_(oracle["images"], training=False))
    assert np.abs(raw - oracle["mobileface_raw"]).max() < 1e-4
    # Through uint8, the images differ by half a grey level.
    coefficients = model.predict(np.uint8(np.rint((oracle["images"] + 1) * 127.5)))[..., 0]
    wanted = oracle["mobileface_coefficients"]
    assert np.abs(coefficients - wanted).max() < 0.02 * np.abs(wanted).max()


@pytest.mark.parametrize(("standardise", "axis"), [("face", 1), ("batch", None)])
def test_mobileface_loss_is_the_mean_squared_error_of_the_meshes(standardise, axis):
    raw = np.random.default_rng(1).normal(2, 3, (24, K))
    used = (raw - raw.mean(axis, keepdims=True)) / raw.std(axis, keepdims=True)
    meshes = [np.tensordot(c, BASIS, 1) for c in (used, CODES[:, :K])]
    loss = untrained("mobileface", standardise=standardise)[0]._loss()
    assert np.allclose(loss(np.float32(CODES[:, :K]), np.float32(raw)), mse(*meshes), rtol=1e-4)


def test_ring_loss_of_codes_by_hand():
    near, far = np.zeros(3), np.full(3, 2.0)  # squared distance 12
    good, swapped = np.float32([[near, near, near, far], [near, far, far, near]])
    assert float(ring_loss(good, 4)) == 0
    # All alike: six ordered pairs at the margin of 0.5, over a ring of four.
    assert np.isclose(float(ring_loss(np.zeros((4, 3), "f4"), 4)), 6 * 0.5 / 4)
    # The stranger is like the first: of its pairs, 12 - 0 + 0.5 each; of the others with it, 0.5.
    assert np.isclose(float(ring_loss(np.r_[good, swapped], 4)), (2 * 12.5 + 2 * 0.5) / 8)


def test_ringnet_projects_a_turned_face_and_weighs_its_losses():
    names = ("landmark", "ring", "identity", "expression")
    model = untrained("ringnet")[0].set_params(**{f"{name}_weight": 0.0 for name in names})
    loss, low, high = RingNetLoss(model, fill=0.6), MEAN.min(0), MEAN.max(0)
    camera = np.random.default_rng(2).normal(0, 0.3, (24, 6))
    camera[0] = 0
    turn = Rotation.from_rotvec(camera[:, 3:]).as_matrix()
    middle, unit = (low + high) / 2, (high - low)[:2].max() / 2 / 0.6
    posed = (SHAPES - middle) / unit @ np.swapaxes(turn, 1, 2)
    wanted = np.exp(camera[:, :1, None]) * posed[..., :2] + camera[:, None, 1:3]
    parameters = np.float32(np.c_[camera, CODES])
    assert np.abs(np.asarray(loss.project(parameters)) - wanted).max() < 1e-5
    moved = np.float32(wanted + [0.1, -0.2]).reshape(24, -1)
    squares = [(codes**2).sum(1).mean() for codes in (CODES[:, :K], CODES[:, K:])]
    parts = 0.15, float(ring_loss(parameters[:, 6 : 6 + K], 4)), *squares
    for name, part in zip(names, parts, strict=True):
        model.set_params(**{f"{name}_weight": 2.0})
        assert np.isclose(float(loss(moved, parameters)), 2 * part, rtol=1e-4)
        model.set_params(**{f"{name}_weight": 0.0})


def test_rings_are_of_one_subject_and_a_stranger():
    members = [np.flatnonzero(subject == SUBJECTS) for subject in range(6)]
    rings = draw_rings(members, 60, 5, 0, 0)
    whose = SUBJECTS[rings]
    assert (whose[:, :-1] == whose[:, :1]).all() and (whose[:, -1] != whose[:, 0]).all()
    assert (np.bincount(whose[:, 0]) == 10).all()
    assert all(len(np.unique(ring)) == 5 for ring in rings)
    assert np.array_equal(rings, draw_rings(members, 60, 5, 0, 0))


@pytest.mark.parametrize(
    ("method", "options", "replaced", "message"),
    [
        ("zhao", {"optimizer": "sgd"}, {}, "optimizer must be one of adam, rmsprop"),
        ("mobileface", {}, {1: CODES[:5, :K]}, r"coefficients must have shape \(24, 4\)"),
        ("mobileface", {}, {1: CODES[:, :K] * np.nan}, "coefficients must be finite"),
        ("mobileface", {"shape_gram": None}, {}, r"shape_gram must have shape \(4, 4\)"),
        (
            "mobileface",
            {"landmark_basis_times_sd": BASIS[:1], "shape_gram": np.ones((1, 1))},
            {1: CODES[:, :1]},
            "landmark_basis_times_sd must be finite, .*components >= 2",
        ),
        ("mobileface", {"standardise": "row"}, {}, "standardise must be one of face, batch"),
        ("ringnet", {}, {1: VIEWS[:5]}, r"landmarks must have shape \(24, 12, 2\)"),
        ("ringnet", {}, {2: np.arange(24) // 2}, "subjects must be two or more with 3 images"),
        ("ringnet", {"ring_size": 2}, {}, "ring_size must be at least 3"),
        ("ringnet", {"expression_basis": EXPRESSIONS[:, 1:]}, {}, "expression_basis must be"),
        ("ringnet", {"image_size": 31}, {}, "image_size must be at least 32"),
    ],
)
def test_unusable_options_and_training_data_are_named(method, options, replaced, message):
    model, data, _ = untrained(method)
    data = [replaced.get(number, array) for number, array in enumerate(data)]
    with pytest.raises(InputError, match=message):
        model.set_params(**options).fit(*data)
