"""RingNet: its size and losses, the view it learns from, and training that goes on."""

import keras
import numpy as np
import pytest
import tensorflow as tf
from keras import layers
from scipy.spatial.transform import Rotation

from data_gen.rendering.renderer import square_frames
from data_gen.views.projections import Cameras, project, rotations
from deepmds_keras import InputError
from deepmds_keras.baselines import ringnet_net
from deepmds_keras.baselines.ringnet import RingNet, draw_rings
from deepmds_keras.baselines.ringnet_losses import (
    LandmarkCamera,
    in_frame,
    landmark_loss,
    ring_loss,
    rotation_matrices,
    total_loss,
)
from deepmds_keras.baselines.ringnet_net import build_ringnet
from deepmds_keras.networks import count_trainable

K, E, L, SIZE = 3, 2, 6, 32


@pytest.fixture(scope="module")
def resnet():
    return build_ringnet(K, E, SIZE)


@pytest.fixture
def small_body(monkeypatch):
    """A body that compiles at once; what follows it, and how it is trained, stays as it is."""

    def body(image_size):
        image = keras.Input((image_size, image_size, 3))
        x = layers.AveragePooling2D(8, name="pool")(image)
        x = layers.Conv2D(16, 2, activation="relu", name="conv")(x)
        x = layers.BatchNormalization(name="conv_bn")(x)
        return keras.Model(image, layers.Flatten(name="features")(x))

    monkeypatch.setattr(ringnet_net, "_resnet50", body)


@pytest.fixture(scope="module")
def bases():
    rng = np.random.default_rng(0)
    mean = rng.normal(0, 30, (L, 3)) + [0, 0, 90]
    return mean, rng.normal(0, 3, (K, L, 3)), rng.normal(0, 3, (E, L, 3))


@pytest.fixture(scope="module")
def toy(bases):
    """Images in which brightness tells the coefficients, and the landmarks of such faces."""
    rng = np.random.default_rng(1)
    subjects = np.repeat(np.arange(6), 4)[rng.permutation(24)]
    codes = np.c_[rng.normal(size=(6, K))[subjects], rng.normal(size=(24, E))]
    bright = np.uint8((128 + 40 * codes).clip(0, 255))
    images = np.zeros((24, SIZE, SIZE, 3), np.uint8)
    for k, (row, column) in enumerate(((0, 0), (0, 16), (16, 0), (16, 16), (8, 8))):
        images[:, row : row + 16, column : column + 16] = bright[:, k, None, None, None]
    shapes = bases[0] + np.tensordot(codes, np.concatenate(bases[1:]), 1)
    return images, square_frames(shapes[..., :2], SIZE, 1.6).pixels(shapes[..., :2]), subjects


def toy_model(bases, **options):
    options = {"epochs": 2, "steps_per_epoch": 3, "rings_per_batch": 2, "ring_size": 4} | options
    return RingNet(*bases, image_size=SIZE, learning_rate=3e-3, **options)


def test_size_is_that_of_resnet50_whatever_the_iterations(resnet):
    assert resnet.output_shape == (None, 6 + K + E)
    resnet50 = 23_587_712 - 53_120  # with a thousand classes cut off, and without moving averages
    n_outputs = 6 + K + E
    regressor = (2048 + n_outputs) * 512 + 512 + 512 * 512 + 512 + 512 * n_outputs + n_outputs
    assert count_trainable(resnet) == resnet50 + regressor > 23_000_000


def test_iterations_share_their_weights(small_body):
    once, thrice = (build_ringnet(K, E, SIZE, iterations=n) for n in (1, 3))
    assert count_trainable(once) == count_trainable(thrice)
    images = np.random.default_rng(0).uniform(-1, 1, (2, SIZE, SIZE, 3))
    for layer in thrice.layers:
        if layer.weights:
            once.get_layer(layer.name).set_weights(layer.get_weights())
    first, third = (np.asarray(net(images, training=False)) for net in (once, thrice))
    assert np.abs(third).max() > 1.5 * np.abs(first).max()


def test_start_is_about_the_mean_face_and_one_image_is_as_good_as_many(resnet):
    images = np.random.default_rng(0).uniform(-1, 1, (3, SIZE, SIZE, 3))
    together = np.asarray(resnet(images, training=False))
    assert np.abs(together).max() < 0.1
    alone = np.concatenate([np.asarray(resnet(one[None], training=False)) for one in images])
    assert np.allclose(alone, together, atol=1e-6)


def test_seed_sets_every_initial_kernel(small_body):
    first, again, other = (
        [kernel.numpy() for kernel in build_ringnet(K, E, SIZE, seed=seed).trainable_weights]
        for seed in (1, 1, 2)
    )
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert [np.array_equal(a, b) for a, b in zip(first, other, strict=True)] == [
        a.ndim == 1 for a in first
    ]


def test_averages_of_the_normalisation_keep_up_with_a_short_training(resnet):
    found = [x.momentum for x in resnet.layers if isinstance(x, layers.BatchNormalization)]
    assert found == [0.9] * 53


def test_ring_loss_of_hand_made_codes():
    near, far = np.zeros(K), np.full(K, 2.0)  # squared distance 12
    good = np.float32([near, near, near, far])
    assert float(ring_loss(good, 4)) == 0
    # All alike: six ordered pairs at the margin of 0.5, over a ring of four.
    assert np.isclose(float(ring_loss(np.zeros((4, K), "f4"), 4)), 6 * 0.5 / 4)
    # The stranger is like the first: of its pairs, 12 - 0 + 0.5 each; of the others with it, 0.5.
    swapped = np.float32([near, far, far, near])
    assert np.isclose(float(ring_loss(swapped, 4)), (2 * 12.5 + 2 * 0.5) / 4)
    both = np.concatenate([good, swapped])
    assert np.isclose(float(ring_loss(both, 4)), 26 / 8)


def test_ring_loss_draws_one_person_together_and_pushes_the_other_away():
    codes = np.random.default_rng(0).normal(size=(4, K)).astype("f4")
    variable = keras.Variable(codes)
    before = float(ring_loss(variable, 4))
    with tf.GradientTape() as tape:
        loss = ring_loss(variable.value, 4)
    after = codes - 0.02 * tape.gradient(loss, variable.value).numpy()
    assert 0 < float(ring_loss(after, 4)) < before

    def spread(ring):
        return ((ring[:3, None] - ring[None, :3]) ** 2).sum()

    def away(ring):
        return ((ring[:3] - ring[3]) ** 2).sum()

    assert spread(after) < spread(codes)
    assert away(after) > away(codes)


def test_rotations_are_rodrigues_also_where_there_is_none():
    vectors = np.concatenate([np.zeros((1, 3)), np.random.default_rng(0).normal(0, 1, (9, 3))])
    found = np.asarray(rotation_matrices(np.float32(vectors)))
    assert np.allclose(found, Rotation.from_rotvec(vectors).as_matrix(), atol=1e-6)


def test_projection_is_the_view_of_a_known_pose(bases):
    rng = np.random.default_rng(2)
    n, fill = 5, 0.6
    cameras = Cameras(np.zeros(n, int), *rng.uniform(-40, 40, (3, n)), np.zeros(n))
    codes = np.c_[rng.normal(size=(n, K)), rng.normal(size=(n, E))]
    shapes = bases[0] + np.tensordot(codes, np.concatenate(bases[1:]), 1)
    views = project(shapes, cameras)
    frames = square_frames(views, SIZE, 1.5)
    wanted = in_frame(frames.pixels(views), SIZE)
    low, high = bases[0].min(0), bases[0].max(0)
    middle = rotations(cameras) @ ((low + high) / 2)
    shift = in_frame(frames.pixels(middle[:, None, :2]), SIZE)[:, 0]
    scale = (high - low)[:2].max() / frames.extent[:, 0] / fill
    turn = Rotation.from_matrix(rotations(cameras)).as_rotvec()
    parameters = np.float32(np.c_[np.log(scale), shift, turn, codes])
    camera = LandmarkCamera(*bases, fill)
    assert np.abs(np.asarray(camera.project(parameters)) - wanted).max() < 1e-5
    assert float(landmark_loss(camera, np.float32(wanted.reshape(n, -1)), parameters)) < 1e-5
    moved = np.float32(wanted + [0.1, -0.2]).reshape(n, -1)
    assert np.isclose(float(landmark_loss(camera, moved, parameters)), 0.15, atol=1e-5)


def test_frame_is_upright():
    assert np.allclose(in_frame([[0, 0], [32, 16]], 32), [[-1, 1], [1, 0]])


def test_total_loss_weighs_its_four_parts(bases):
    camera = LandmarkCamera(*bases, 0.7)
    rng = np.random.default_rng(3)
    parameters = rng.normal(0, 0.3, (8, 6 + K + E)).astype("f4")
    landmarks = rng.uniform(-1, 1, (8, 2 * L)).astype("f4")
    parts = {
        "landmark": float(landmark_loss(camera, landmarks, parameters)),
        "ring": float(ring_loss(parameters[:, 6 : 6 + K], 4)),
        "identity": (parameters[:, 6 : 6 + K] ** 2).sum(1).mean(),
        "expression": (parameters[:, 6 + K :] ** 2).sum(1).mean(),
    }
    for name, value in parts.items():
        weights = dict.fromkeys(parts, 0.0) | {name: 2.0}
        found = float(total_loss(camera, 4, weights)(landmarks, parameters))
        assert np.isclose(found, 2 * value, rtol=1e-4) and value > 0


def test_rings_are_of_one_subject_and_a_stranger():
    subjects = np.random.default_rng(0).permutation(np.repeat(np.arange(7), 6))
    members = [np.flatnonzero(subjects == subject) for subject in range(7)]
    rings = draw_rings(members, 70, 6, 0, 0)
    whose = subjects[rings]
    assert (whose[:, :-1] == whose[:, :1]).all()
    assert (whose[:, -1] != whose[:, 0]).all()
    assert (np.bincount(whose[:, 0]) == 10).all()
    assert all(len(np.unique(ring)) == 6 for ring in rings)
    assert len(np.unique(rings)) == 42
    assert np.array_equal(rings, draw_rings(members, 70, 6, 0, 0))
    assert not np.array_equal(rings, draw_rings(members, 70, 6, 0, 1))


@pytest.mark.slow
def test_training_learns_without_a_3d_shape_and_predicts_in_the_models_frame(
    toy, bases, small_body
):
    images, landmarks, subjects = toy
    model = toy_model(bases, epochs=6, steps_per_epoch=40).fit(images, landmarks, subjects)
    assert model.history_["train"][-1] < 0.6 * model.history_["train"][0]
    mean_pose = np.abs(landmarks - landmarks.mean(0)).mean() * 2 / SIZE
    assert model.history_["inference"][-1] < 0.7 * mean_pose
    identity, expression = model.coefficients(images[:7])
    shapes = model.predict(images[:7])
    offsets = np.tensordot(np.c_[identity, expression], np.concatenate(bases[1:]), 1)
    assert shapes.shape == (7, L, 3)
    assert np.allclose(shapes, bases[0] + offsets, atol=1e-4)
    assert np.allclose(model.predict(images[:1]), shapes[:1], atol=1e-3)
    assert model.n_parameters == count_trainable(model.network_)


@pytest.mark.slow
def test_stopped_training_goes_on_to_the_same_weights(toy, bases, small_body, tmp_path):
    whole = toy_model(bases).fit(*toy)

    def stop(losses):
        raise KeyboardInterrupt

    path = tmp_path / "ringnet.npz"
    with pytest.raises(KeyboardInterrupt):
        toy_model(bases).fit(*toy, checkpoint=path, progress=stop)
    with pytest.raises(InputError, match="ringnet.npz is not trained to the end. Received 1 of 2"):
        toy_model(bases).restore(path)
    seen = []
    resumed = toy_model(bases).fit(*toy, checkpoint=path, progress=seen.append)
    assert len(seen) == 2
    assert resumed.history_ == whole.history_
    restored = toy_model(bases).restore(path)
    for weights in zip(*(m.network_.weights for m in (whole, resumed, restored)), strict=True):
        assert np.array_equal(weights[0].numpy(), weights[1].numpy())
        assert np.array_equal(weights[0].numpy(), weights[2].numpy())
    with pytest.raises(InputError, match="ringnet.npz is of another run"):
        toy_model(bases, ring_weight=2.0).fit(*toy, checkpoint=path)


@pytest.mark.parametrize(
    "images",
    [
        np.zeros((1, SIZE, SIZE, 3), np.float32),
        np.zeros((1, SIZE, SIZE, 4), np.uint8),
        np.zeros((1, SIZE - 1, SIZE, 3), np.uint8),
        np.zeros((0, SIZE, SIZE, 3), np.uint8),
    ],
)
def test_images_of_another_kind_are_refused(bases, images):
    model = toy_model(bases)
    with pytest.raises(InputError, match="call fit or restore first"):
        model.predict(images)
    model.network_ = keras.Sequential([keras.Input((SIZE, SIZE, 3)), layers.Flatten()])
    with pytest.raises(InputError, match=r"images must be uint8 of shape .* Received"):
        model.predict(images)


def test_unusable_training_data_are_refused(toy, bases):
    images, landmarks, subjects = toy
    model = toy_model(bases)
    with pytest.raises(InputError, match=r"landmarks must have shape \(24, 6, 2\)"):
        model.fit(images, landmarks[:5], subjects)
    with pytest.raises(InputError, match=r"subjects must have shape \(24,\)"):
        model.fit(images, landmarks, subjects[:5])
    with pytest.raises(InputError, match="subjects must be two or more with 3 images each or more"):
        model.fit(images, landmarks, np.arange(24) // 2)
    with pytest.raises(InputError, match="subjects must be two or more"):
        model.fit(images, landmarks, np.zeros(24, int))
    with pytest.raises(InputError, match="ring_size must be at least 3"):
        toy_model(bases, ring_size=2).fit(*toy)
    with pytest.raises(InputError, match="expression_basis must have shape"):
        toy_model((*bases[:2], bases[2][:, :3])).fit(*toy)
    with pytest.raises(InputError, match="image_size must be at least 32"):
        build_ringnet(K, E, 31)
