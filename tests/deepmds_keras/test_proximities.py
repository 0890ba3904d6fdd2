"""Pair features: their values, their order, and that a pair has no first and second."""

import numpy as np
import pytest

from deepmds_keras import InputError, pair_features


@pytest.fixture
def views():
    return np.random.default_rng(0).random((3, 7, 2))


def test_papers_features_of_one_pair():
    features = pair_features(np.array([[0.2, 0.5], [0.6, 0.4], [0.0, 0.0]]))
    assert features.shape == (3, 6)
    assert np.allclose(features[0], [0.4, 0.1, 0.12, 0.2, np.exp(-0.4), np.exp(-0.1)])


def test_released_features_of_one_pair():
    features = pair_features(np.array([[0.2, 0.5], [0.6, 0.4], [0.0, 0.0]]), "released")
    expected = [0.12, 0.2, np.exp(-0.4), np.exp(-0.1), np.hypot(0.4, 0.1)]
    assert np.allclose(features[0], expected)


def test_batch_equals_one_by_one(views):
    one_by_one = [pair_features(view) for view in views]
    assert np.array_equal(pair_features(views), one_by_one)
    assert pair_features(views).dtype == np.float32


def test_bad_input_is_named(views):
    with pytest.raises(InputError, match="variant must be one of paper, released. Received 'new'"):
        pair_features(views, "new")
    with pytest.raises(InputError, match=r"views must have shape .* Received \(3, 7, 3\)"):
        pair_features(np.zeros((3, 7, 3)))


def test_the_graph_makes_the_same_pairs_as_numpy(views):
    import tensorflow.experimental.numpy as tnp

    from deepmds_keras.proximities import proximities

    first, second = np.float32(views[:, :-1]), np.float32(views[:, 1:])
    for variant in ("paper", "released"):
        inside = proximities(tnp.array(first), tnp.array(second), variant, tnp)
        assert np.allclose(inside, proximities(first, second, variant), atol=1e-6)
