"""A stream of faces: the same numbers by any processes, those of the method, from where it was."""

import shutil

import numpy as np
import pandas as pd
import pytest
import runs
from scipy.stats import sem

from data_gen.datasets.dataset import make_dataset
from data_gen.models.registry import load_model
from deepmds_keras.files import read_arrays
from experiments.inputs import as_seen
from experiments.methods import load, predict
from experiments.presets import TINY
from experiments.run import Run
from experiments.scoring.scores import score
from experiments.streams import Stream

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(whole_bfm, tmp_path_factory):
    """A stream of 25 faces in three shards, in two parts."""
    folder = tmp_path_factory.mktemp("stream")
    source, target = (runs.work(place, "bfm") for place in (whole_bfm, folder))
    target.mkdir(parents=True)
    for name in ("train.npz", "networks", "records"):
        (target / name).symlink_to(source / name)
    stream(folder, 25)
    return folder


def stream(folder, n):
    """Run both parts, and what gathers them."""
    for part in ("0-20", f"20-{n}"):
        runs.succeed("studies.stream_part", folder, part, "--faces", str(n))
    runs.succeed("studies.stream", folder, "--faces", str(n))


def table_of(folder):
    return runs.results(folder, "stream") / "table.csv"


def shards(folder):
    return sorted((runs.work(folder, "bfm") / "stream").glob("*.npz"))


def test_its_numbers_are_those_of_the_method_on_distinct_faces(folder):
    """By scikit-learn's solver, in a process with other settings of TensorFlow."""
    assert [path.name for path in shards(folder)] == ["00000-10.npz", "00001-10.npz", "00002-5.npz"]
    run, model = Run("openhead", TINY, build=folder / "build", jobs=1), load_model("openhead")
    parts = [
        as_seen(make_dataset(model, n, np.random.default_rng([0, Stream.STREAMED_FACES, shard])))
        for shard, n in enumerate((10, 10, 5))
    ]
    table = pd.read_csv(table_of(folder)).set_index(["method", "metric"])
    assert (table["n_faces"] == 25).all()
    for method in ("mean_shape", "deep_mds"):
        fitted = load(run, method)
        errors = np.concatenate([score(predict(fitted, part.views), part).mse for part in parts])
        assert len({*errors}) == 25, "no face twice"
        row = table.loc[method, ["mean", "standard_error", "median", "maximum"]].loc["mse"]
        expected = errors.mean(), sem(errors), np.median(errors), errors.max()
        assert row.tolist() == pytest.approx(expected, rel=1e-4)


def test_it_goes_on_where_it_was(folder):
    """A missing shard is written again, and more faces keep those that are there."""
    table, second = table_of(folder).read_bytes(), shards(folder)[1]
    errors, _ = read_arrays(second)
    second.unlink()
    kept = {path: path.stat().st_mtime_ns for path in shards(folder)}
    stream(folder, 25)
    assert table_of(folder).read_bytes() == table
    for name, values in read_arrays(second)[0].items():
        np.testing.assert_array_equal(values, errors[name])
    stream(folder, 32)
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert len(shards(folder)) == 5  # the third is whole now, and has another name
    assert (pd.read_csv(table_of(folder))["n_faces"] == 32).all()


def test_shards_of_other_networks_are_not_used(folder, tmp_path):
    shutil.copytree(runs.work(folder, "bfm"), runs.work(tmp_path, "bfm"))
    networks = runs.work(tmp_path, "bfm") / "networks"
    other, ours = (networks / f"dissimilarity-paper-{rate}.npz" for rate in ("cosine", "constant"))
    shutil.copy(other, ours)
    done = runs.run("studies.stream_part", tmp_path, "0-25", "--faces", "25")
    assert done.returncode == 2 and "is from another run" in done.stderr
    assert shards(tmp_path) == []
