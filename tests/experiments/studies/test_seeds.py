"""The spread over seeds, and batch statistics estimated anew."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import runs

from deepmds_keras.networks import build_autoencoder, forward
from experiments.presets import TINY
from experiments.records import with_checksum, write_json
from experiments.run import Run
from experiments.scoring.scores import metrics_by_seed, runs_by_seed
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


def test_seeds_are_those_that_were_trained_whatever_is_asked_for(tmp_path):
    run = Run("openhead", TINY, build=tmp_path)
    assert metrics_by_seed(run) is None
    for own in runs_by_seed(replace(run, seeds=3)):
        row = ["ours", "mse", float(own.seed)]
        write_json(own.record_file("seed"), with_checksum({"rows": [row]}))
    write_json(run.record_file("seeds"), with_checksum({"n_seeds": 3}))
    assert run.n_seeds == 2
    assert metrics_by_seed(run)["seed"].tolist() == [0, 1, 2]


@pytest.mark.slow
def test_the_table_shows_the_spread_over_seeds(whole_bfm, tmp_path):
    """The first seed is the run itself; MSE and range are those of the seeds."""
    shutil.copytree(whole_bfm.folder, tmp_path, dirs_exist_ok=True)
    for stage in ("seed", "seeds", "bfm"):
        runs.succeed(stage, tmp_path, "--seeds", "2", "--jobs", "1")
    metrics = pd.read_csv(runs.results(tmp_path, "seeds") / "metrics.csv")
    table = pd.read_csv(runs.results(tmp_path, "bfm") / "table.csv").set_index(["method", "metric"])
    for method in ("ours", "ours_released", "ours_stable"):
        own = metrics[(metrics["method"] == method) & (metrics["metric"] == "mse")]
        assert own["seed"].tolist() == [0, 1]
        first, second = own["value"]
        assert first != second
        row = table.loc[method, "mse"]
        assert row["n_seeds"] == 2
        assert row[["lowest", "highest"]].tolist() == sorted((first, second))
        assert abs(row["median"] - (first + second) / 2) < 1e-9
    assert table.loc["linear", "mse"][["n_seeds", "median"]].isna().all()
    made = json.loads((runs.results(tmp_path, "bfm") / "manifest.json").read_text())
    assert " SEEDS=2" in made["command"]


@pytest.mark.slow
def test_the_same_seed_gives_the_same_unless_it_is_rounded_otherwise(whole_bfm, tmp_path):
    shutil.copytree(whole_bfm.folder, tmp_path, dirs_exist_ok=True)
    runs.succeed("rounding", tmp_path)
    table = pd.read_csv(runs.results(tmp_path, "rounding") / "table.csv").set_index("rounding")
    errors = table["mse"]
    assert errors["as trained"] == errors["again"]
    assert errors["SSE 4.2 at most"] != errors["again"]
    assert (abs(errors / errors["again"] - 1) < 0.1).all()
