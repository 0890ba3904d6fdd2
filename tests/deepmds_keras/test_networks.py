"""Both networks: their sizes as published, their wiring, and the authors' weights in them."""

import keras
import numpy as np
import pytest
from places import SHARED

from deepmds_keras import DeepMDS, InputError, build_autoencoder, build_dissimilarity_net
from deepmds_keras.networks import forward
from deepmds_keras.normalisation import normalise
from deepmds_keras.proximities import VARIANTS

RELEASED = SHARED / "released" / "bfm"


def trainable(network):
    return sum(int(np.prod(weight.shape)) for weight in network.trainable_weights)


@pytest.mark.parametrize(
    ("n_landmarks", "ours", "total"), [(72, 24_880, 25_584), (51, 19_378, 19_998)]
)
def test_autoencoder_has_the_papers_number_of_parameters(n_landmarks, ours, total):
    network = build_autoencoder(n_landmarks)
    assert (trainable(network), network.count_params()) == (ours, total)
    assert network.input_shape == network.output_shape == (None, 2 * n_landmarks)


@pytest.mark.parametrize(
    ("variant", "ours", "total"), [("released", 2423, 2625), ("paper", 2443, 2645)]
)
def test_dissimilarity_net_has_less_than_3000_parameters(variant, ours, total):
    network = build_dissimilarity_net(variant)
    assert (trainable(network), network.count_params()) == (ours, total)
    assert total < 3000
    assert network.input_shape == (None, VARIANTS[variant])


def test_short_connection_reaches_past_the_third_layer():
    network = build_dissimilarity_net()
    inputs = np.random.default_rng(0).random((9, 6), np.float32)
    network.get_layer("hidden_3").set_weights(
        [np.zeros_like(w) for w in network.get_layer("hidden_3").get_weights()]
    )
    assert np.ptp(forward(network, inputs)) > 1e-3


def test_networks_are_functional_uncompiled_and_named():
    for network in (build_autoencoder(51), build_dissimilarity_net("released")):
        assert type(network) is keras.Model or isinstance(network, keras.src.models.Functional)
        assert not network.compiled
    assert build_autoencoder(51).name == "autoencoder_51"


def test_seed_decides_the_weights():
    first, again, other = (build_autoencoder(51, seed=s).get_weights() for s in (1, 1, 2))
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0], other[0])


def test_forward_equals_predict():
    network = build_autoencoder(51)
    inputs = np.random.default_rng(0).random((10, 102), np.float32)
    assert np.allclose(forward(network, inputs, 3), network.predict(inputs, verbose=0), atol=1e-6)


def test_forward_of_many_batches_is_that_of_one_and_of_the_weights_as_they_are():
    network = build_dissimilarity_net()
    inputs = np.random.default_rng(0).random((100, 6))
    for scale in (1, 1.5):
        network.set_weights([scale * weight for weight in network.get_weights()])
        assert np.allclose(forward(network, inputs, 30), forward(network, inputs), atol=1e-6)


def test_unknown_variant_is_named():
    with pytest.raises(InputError, match="variant must be one of paper, released. Received 'x'"):
        build_dissimilarity_net("x")


@pytest.mark.skipif(not RELEASED.is_dir(), reason="the authors' weights (../shared) are absent")
def test_the_authors_weights_reproduce_what_the_authors_code_gives():
    model = DeepMDS.from_released(RELEASED / "AE_occ2orth_BFM.h5", RELEASED / "deep_dissim_ours.h5")
    with np.load(RELEASED / "oracle.npz", allow_pickle=False) as oracle:
        views, frontal, distances = (
            oracle[key] for key in ("views", "autoencoder", "dissimilarity")
        )
    assert np.allclose(normalise(views), views, atol=1e-6)
    assert np.abs(model.frontalise(views) - frontal).max() < 1e-5
    assert np.abs(model.dissimilarities(views) - distances).max() < 1e-5
    assert model.n_parameters == 24_880 + 2423
