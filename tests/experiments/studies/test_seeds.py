"""The spread over seeds, and batch statistics estimated anew."""

import numpy as np
import pandas as pd

from deepmds_keras.networks import build_autoencoder, forward
from experiments.studies.batchnorm import recalibrate_batchnorm
from experiments.studies.seeds import spread


def test_statistics_estimated_anew_are_those_of_the_faces_given():
    network = build_autoencoder(51)
    inputs = np.random.default_rng(0).random((40, 102), np.float32)
    before = network.get_weights()
    anew = recalibrate_batchnorm(network, inputs)
    in_training = np.asarray(network(inputs, training=True))
    network.set_weights(before)
    assert np.allclose(forward(anew, inputs), in_training, atol=1e-5)
    assert not np.allclose(forward(network, inputs), in_training, atol=1e-2)


def test_network_is_left_as_it_was():
    network = build_autoencoder(51)
    before = network.get_weights()
    recalibrate_batchnorm(network, np.random.default_rng(0).random((40, 102), np.float32))
    assert all(np.array_equal(a, b) for a, b in zip(before, network.get_weights(), strict=True))


def test_spread_is_over_the_seeds_of_a_method():
    rows = [("ours", seed, "mse", value) for seed, value in enumerate((1.0, 2.0, 9.0))]
    rows += [("ours_stable", 0, "mse", 4.0)]
    table = spread(pd.DataFrame(rows, columns=["method", "seed", "metric", "value"]))
    assert table.iloc[0].tolist()[:4] == ["ours", "mse", 2.0, 4.0]
    assert table.iloc[0][["min", "max", "count"]].tolist() == [1.0, 9.0, 3]
    assert table["method"].tolist() == ["ours", "ours_stable"]
