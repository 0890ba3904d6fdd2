"""A stream of faces: the same numbers however it is made, and those of the table."""

import json

import numpy as np
import pandas as pd
import pytest
import runs

from data_gen.datasets.dataset import load_dataset
from deepmds_keras.io.archives import read_arrays
from experiments.inputs import as_seen
from experiments.manifest import files_of, read_manifest
from experiments.methods import load
from experiments.presets import TINY
from experiments.run import Run
from experiments.scoring.scores import score
from experiments.studies.shards import Shards

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(whole_bfm, tmp_path_factory):
    """A stream of 25 faces in three files, made by two processes."""
    folder = tmp_path_factory.mktemp("stream")
    work, mine = (runs.work(own, "bfm") for own in (whole_bfm.folder, folder))
    mine.mkdir(parents=True)
    for name in ("train.npz", "networks", "faces.json", "networks.json"):
        (mine / name).symlink_to(work / name)
    stream(folder, 25, "--jobs", "2")
    return folder


def stream(folder, n, *more):
    runs.succeed("stream", folder, "--faces", str(n), *more)


def results(folder):
    return runs.results(folder, "stream")


def files(folder):
    return sorted((folder / "build").glob("*/*/stream/*/*.npz"))


def test_a_stream_holds_each_face_once(folder):
    assert [path.name for path in files(folder)] == 2 * ["00000.npz", "00001.npz", "00002-5.npz"]
    sizes = [len(read_arrays(path)[0]["ours"]) for path in files(folder)[3:]]
    assert sizes == [10, 10, 5]
    first, second = (load_dataset(path).landmarks for path in files(folder)[:2])
    assert not np.isclose(first, second).all((1, 2)).any()


def test_its_numbers_are_those_of_the_method(folder):
    """Also by scikit-learn's solver and in a process with other settings of TensorFlow."""
    run = Run("openhead", TINY, build=folder / "build", jobs=1)
    parts = [as_seen(load_dataset(path)) for path in files(folder)[:3]]
    table = pd.read_csv(results(folder) / "table.csv").set_index(["method", "metric"])
    assert (table["n_faces"] == 25).all()
    for method in ("mean_shape", "ours"):
        fit = load(run, method)
        errors = np.concatenate([score(fit.predict(own.views), own).mse for own in parts])
        row = table.loc[method, "mse"]
        assert row["mean"] == pytest.approx(errors.mean(), rel=1e-4)
        assert row["standard_error"] == pytest.approx(errors.std(ddof=1) / np.sqrt(25), rel=1e-4)
        assert row["median"] == pytest.approx(np.median(errors), rel=1e-4)
        assert row["maximum"] == pytest.approx(errors.max(), rel=1e-4)


def test_its_folder_says_what_made_it(folder):
    made = read_manifest(results(folder))
    assert "FACES=25" in made["command"]
    assert made["files"] == files_of(results(folder)) and "table.csv" in made["files"]
    record = json.loads(next(folder.rglob("stream.json")).read_text())
    assert len(record["processes_mb"]) == 2


def test_it_goes_on_where_it_was_and_by_other_processes_alike(folder):
    """One process makes the missing file again, and more faces beside those that are there."""
    table = (results(folder) / "table.csv").read_bytes()
    faces, shapes = files(folder)[1], files(folder)[4]
    content = faces.read_bytes(), shapes.read_bytes()
    faces.unlink()
    shapes.unlink()
    others = {path: path.stat().st_mtime_ns for path in files(folder)}
    stream(folder, 25, "--jobs", "1")
    assert (faces.read_bytes(), shapes.read_bytes()) == content
    assert (results(folder) / "table.csv").read_bytes() == table
    stream(folder, 32, "--jobs", "1")
    assert {path: path.stat().st_mtime_ns for path in others} == others
    assert len(files(folder)) == 2 * 5  # the third is whole now, and has another name
    assert (pd.read_csv(results(folder) / "table.csv")["n_faces"] == 32).all()


def test_what_another_network_made_is_not_taken_for_its_own(tmp_path):
    old, new = (Shards(tmp_path, 10, 5, digest * 64) for digest in "ab")
    assert old.faces(1) == new.faces(1)
    assert old.shapes(1) != new.shapes(1)


def test_a_number_of_faces_that_cannot_be_is_refused(folder):
    done = runs.run("stream", folder, "--faces", "1")
    assert done.returncode == 2
    assert "--faces must be at least 2. Received 1." in done.stderr
