"""Both networks: sizes as published, wiring, features, the authors' weights, and training."""

import keras
import numpy as np
import pytest
from places import SHARED

from deepmds_keras import (
    DeepMDS,
    InputError,
    build_autoencoder,
    build_dissimilarity_net,
    normalise,
    pair_features,
)
from deepmds_keras.files import read_arrays, write_arrays
from deepmds_keras.networks import count_trainable, forward
from deepmds_keras.proximities import VARIANTS, proximities
from deepmds_keras.training import (
    Recipe,
    face_order,
    steps_per_call,
    train_autoencoder,
    train_dissimilarity_net,
)

RELEASED = SHARED / "released" / "bfm"


@pytest.mark.parametrize(
    ("network", "trainable", "total", "inputs"),
    [
        (build_autoencoder(72), 24_880, 25_584, 144),
        (build_autoencoder(51), 19_378, 19_998, 102),
        (build_dissimilarity_net("released"), 2423, 2625, 5),
        (build_dissimilarity_net("paper"), 2443, 2645, 6),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_networks_are_functional_uncompiled_and_as_large_as_published(
    network, trainable, total, inputs
):
    assert (count_trainable(network), network.count_params()) == (trainable, total)
    assert network.input_shape == (None, inputs)
    assert isinstance(network, keras.src.models.Functional) and not network.compiled


def test_skip_connection_reaches_past_the_third_layer():
    network = build_dissimilarity_net()
    third = network.get_layer("hidden_3")
    third.set_weights([np.zeros_like(weight) for weight in third.get_weights()])
    assert np.ptp(forward(network, np.random.default_rng(0).random((9, 6), np.float32))) > 1e-3


def test_forward_of_many_batches_is_that_of_one_and_of_the_weights_as_they_are():
    network = build_dissimilarity_net()
    inputs = np.random.default_rng(0).random((100, 6), np.float32)
    for scale in (1, 1.5):
        network.set_weights([scale * weight for weight in network.get_weights()])
        expected = network.predict(inputs, verbose=0)
        assert np.allclose(forward(network, inputs, 30), expected, atol=1e-6)
        assert np.allclose(forward(network, inputs), expected, atol=1e-6)


def test_features_of_a_pair_are_the_papers_or_those_of_the_released_code():
    view = np.array([[0.2, 0.5], [0.6, 0.4], [0.0, 0.0]])
    product, exponential = [0.12, 0.2], [np.exp(-0.4), np.exp(-0.1)]
    paper, released = pair_features(view), pair_features(view, "released")
    assert paper.shape == (3, 6) and paper.dtype == np.float32
    assert np.allclose(paper[0], [0.4, 0.1, *product, *exponential])
    assert np.allclose(released[0], [*product, *exponential, np.hypot(0.4, 0.1)])


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_batch_has_the_features_of_its_faces(variant):
    views = np.random.default_rng(0).random((3, 7, 2), np.float32)
    assert np.array_equal(pair_features(views, variant), [pair_features(v, variant) for v in views])


def test_bad_input_is_named():
    for build in (build_dissimilarity_net, lambda variant: pair_features(np.ones((4, 2)), variant)):
        with pytest.raises(
            InputError, match="variant must be one of paper, released. Received 'x'"
        ):
            build("x")
        with pytest.raises(InputError, match=r"Received \['paper'\]"):
            build(["paper"])
    with pytest.raises(InputError, match=r"views must have shape .* Received \(3, 7, 3\)"):
        pair_features(np.zeros((3, 7, 3)))
    with pytest.raises(InputError, match="views must hold numbers. Received dtype complex128"):
        pair_features(np.full((7, 2), 1j))


@pytest.mark.skipif(not RELEASED.is_dir(), reason="the authors' weights (../shared) are absent")
def test_the_authors_weights_reproduce_what_the_authors_code_gives():
    model = DeepMDS.from_released(RELEASED / "AE_occ2orth_BFM.h5", RELEASED / "deep_dissim_ours.h5")
    with np.load(RELEASED / "oracle.npz", allow_pickle=False) as oracle:
        views, frontal, distances = map(oracle.get, ("views", "autoencoder", "dissimilarity"))
    assert np.allclose(normalise(views), views, atol=1e-6)
    assert np.abs(model.frontalise(views) - frontal).max() < 1e-5
    assert np.abs(model.dissimilarities(views) - distances).max() < 1e-5
    assert model.n_parameters == 24_880 + 2423


@pytest.fixture(scope="module")
def faces():
    rng = np.random.default_rng(0)
    shapes = normalise(rng.random((1, 12, 3)) + 0.1 * rng.normal(size=(64, 12, 3)))
    return np.float32(normalise(shapes[..., :2])), np.float32(shapes)


def autoencoder(faces, recipe, **options):
    return train_autoencoder(faces[0], faces[1][..., :2], recipe, **options)


def test_losses_fall_and_inference_is_that_of_the_network(faces):
    network, history = autoencoder(faces, Recipe(4, 500, "cosine", 3e-3))
    assert history["train"][-1] < 0.1 * history["train"][0]
    views, frontal = faces[0].reshape(64, -1), faces[1][..., :2].reshape(64, -1)
    error = np.mean((network.predict(views, verbose=0) - frontal) ** 2)
    assert np.isclose(history["inference"][-1], error, rtol=1e-4)


@pytest.mark.slow
def test_released_variant_sees_self_pairs_too(faces):
    """The paper's pairs are those i < j; the released code also trains the diagonal towards 0."""
    recipe = Recipe(4, 500, "cosine", learning_rate=0.01)
    diagonals, points = {}, faces[0].reshape(-1, 2)
    for variant in ("paper", "released"):
        network, _ = train_dissimilarity_net(*faces, recipe, variant=variant)
        diagonals[variant] = np.abs(forward(network, proximities(points, points, variant))).mean()
    assert diagonals["released"] < 0.5 * diagonals["paper"]


def test_checkpoints_of_another_run_and_damaged_ones_are_refused(faces, tmp_path):
    path = tmp_path / "checkpoint.npz"
    recipe = Recipe(1, 53)
    first = autoencoder(faces, recipe, checkpoint=path)[1]
    assert autoencoder(faces, recipe, seed=2)[1] != first
    others = (
        (faces, recipe, 1, "seed"),
        (faces, Recipe(1, 53, learning_rate=2e-3), 0, "learning_rate"),
        (tuple(part[:, 1:] for part in faces), recipe, 0, "network"),
        ((faces[0][::-1], faces[1]), recipe, 0, "data"),
        ((faces[0], faces[1] * 0.99), recipe, 0, "data"),
    )
    for data, other, seed, name in others:  # as many faces of other data were taken for the same
        with pytest.raises(
            InputError, match=f"is from another run; delete it.* Received .'{name}'"
        ):
            autoencoder(data, other, checkpoint=path, seed=seed)
    arrays, described = read_arrays(path)
    write_arrays(path, arrays, {"history": described["history"]})
    with pytest.raises(InputError, match="is from another run"):
        autoencoder(faces, recipe, checkpoint=path)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(InputError, match="checkpoint.npz must be an npz written by save"):
        autoencoder(faces, recipe, checkpoint=path)
    with pytest.raises(InputError, match="schedule must be one of constant, cosine"):
        autoencoder(faces, Recipe(1, schedule="linear"))


def test_every_face_is_seen_equally_often_and_no_call_of_the_graph_is_a_partial_one():
    epochs = [face_order(10, 4, seed=0, epoch=epoch) for epoch in range(5)]
    assert np.array_equal(np.bincount(np.concatenate(epochs)), np.full(10, 2))
    assert not np.array_equal(np.sort(epochs[0]), np.sort(epochs[1]))
    assert [steps_per_call(steps) for steps in (1250, 1000, 97, 53, 7)] == [50, 50, 1, 1, 7]
