"""Statistics over seeds, and batch statistics recalibrated."""

import shutil

import numpy as np
import pandas as pd
import pytest
import runs

from deepmds_keras.networks import build_autoencoder, forward
from experiments.studies.seed import recalibrate_batchnorm
from experiments.studies.study_results import statistics_cells


def test_recalibrated_statistics_are_those_of_the_given_faces():
    network = build_autoencoder(51)
    inputs = np.random.default_rng(0).random((40, 102), np.float32)
    before = network.get_weights()
    recalibrated = recalibrate_batchnorm(network, inputs)
    assert all(np.array_equal(a, b) for a, b in zip(before, network.get_weights(), strict=True))
    in_training = np.asarray(network(inputs, training=True))
    network.set_weights(before)
    assert np.allclose(forward(recalibrated, inputs), in_training, atol=1e-5)
    assert not np.allclose(forward(network, inputs), in_training, atol=1e-2)


def test_readers_see_words_units_and_whole_counts():
    rows = [("ridge", "mse", 1.5e-5, 1200), ("ridge", "autoencoder_mse_train", 2e-4, 3)]
    table = pd.DataFrame(rows, columns=["method", "metric", "standard_error", "count"])
    cells = statistics_cells(table).reset_index()
    assert cells.to_numpy().tolist() == [
        ["Ridge regression", "MSE (10⁻⁴)", "0.15", "1,200"],
        ["Ridge regression", "autoencoder's MSE, training mode (10⁻⁴)", "2", "3"],
    ]
    assert [*cells] == ["method", "metric", "standard error", "count"]


@pytest.mark.slow
def test_the_table_shows_the_spread_over_seeds(whole_bfm, tmp_path):
    """The first seed is the run itself; MSE and range are those of the seeds."""
    shutil.copytree(whole_bfm, tmp_path, dirs_exist_ok=True)
    runs.make("reproduce-bfm", tmp_path, "SEEDS=2")
    runs.make("seeds", tmp_path, "SEEDS=2")
    metrics = pd.read_csv(runs.results(tmp_path, "seeds") / "metrics.csv")
    seeds = metrics[metrics["metric"] == "mse"].pivot(index="method", columns="seed")["value"]
    table = pd.read_csv(runs.results(tmp_path, "bfm") / "table.csv").set_index(["method", "metric"])
    rows = table.xs("mse", level="metric").loc[seeds.index]
    trained = {"deep_mds", "deep_mds_released", "deep_mds_cosine"}
    assert {*rows.index} == {"mean_shape", "deep_mds_constant", *trained}
    assert (seeds[0] != seeds[1]).all()
    assert (rows["n_seeds"] == 2).all()
    np.testing.assert_allclose(rows[["lowest", "highest"]], np.sort(seeds), rtol=1e-7)
    np.testing.assert_allclose(rows["median"], seeds.mean(axis=1), rtol=1e-7)
    assert table.loc["ridge", "mse"][["n_seeds", "median"]].isna().all()
