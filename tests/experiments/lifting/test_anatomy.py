"""The anatomy: every step is the method with one part replaced, and nothing else."""

import json

import numpy as np
import pandas as pd
import pytest
import runs

from deepmds_keras.pipeline import DeepMDS
from experiments.inputs import load_faces
from experiments.lifting.anatomy import net_file
from experiments.lifting.study_tables import EMBEDDINGS, STEPS
from experiments.manifest import files_of, read_manifest
from experiments.methods import load
from experiments.presets import TINY
from experiments.run import Run
from experiments.scoring.scores import score


@pytest.fixture(scope="module")
def folder(whole_bfm, tmp_path_factory):
    folder = tmp_path_factory.mktemp("anatomy")
    work, mine = (runs.work(own, "bfm") for own in (whole_bfm.folder, folder))
    mine.mkdir(parents=True)
    for name in ("train.npz", "test.npz", "networks", "faces.json", "networks.json"):
        (mine / name).symlink_to(work / name)
    runs.succeed("anatomy", folder, "--jobs", "1")
    return folder


@pytest.fixture(scope="module")
def run(folder):
    return Run("openhead", TINY, build=folder / "build", jobs=1)


@pytest.fixture(scope="module")
def errors(folder):
    table = pd.read_csv(runs.results(folder, "lifting/anatomy") / "table.csv")
    assert {*table["step"]} == STEPS.keys() and {*table["embedding"]} == EMBEDDINGS.keys()
    assert (table["n_faces"] == TINY.audited_faces).all()
    return table.set_index(["step", "embedding"])["mse"]


@pytest.mark.slow
def test_first_step_is_the_method_as_it_is(run, errors):
    test = load_faces(run, "test")[: TINY.audited_faces]
    own = score(load(run, "ours_stable").predict(test.views), test).mse.mean()
    assert errors["deep_mds", "non_metric"] == pytest.approx(own, rel=1e-3)


@pytest.mark.slow
def test_of_euclidean_distances_either_embedding_gives_the_shape_back(run, errors):
    test = load_faces(run, "test")[: TINY.audited_faces]
    own = score(load(run, "lifting").predict(test.views), test).mse.mean()
    for embedding in ("non_metric", "metric"):
        assert errors["lifting", embedding] == pytest.approx(own, rel=1e-2)
        assert errors["true_distances", embedding] < 1e-12
    assert errors["limit", "none"] < own < errors["mean_shape", "none"]


@pytest.mark.slow
def test_folder_says_what_made_it(folder):
    results = runs.results(folder, "lifting/anatomy")
    made = read_manifest(results)
    assert made["command"].startswith("make lifting ")
    assert made["files"] == files_of(results)
    assert {"table.csv", "table.tex", "figures/anatomy.png"} <= made["files"].keys()
    stages = [record["stage"] for record in made["stages"]]
    assert stages == ["faces", "networks", "anatomy"]


@pytest.mark.slow
def test_what_is_trained_is_kept_and_belongs_to_the_networks(folder, run):
    path = net_file(run, "whole_view")
    written, table = path.stat().st_mtime_ns, runs.results(folder, "lifting/anatomy") / "table.csv"
    before = table.read_bytes()
    (run.work / "anatomy.json").unlink()
    runs.succeed("anatomy", folder, "--jobs", "1")
    assert (path.stat().st_mtime_ns, table.read_bytes()) == (written, before)
    networks = run.work / "networks.json"
    record = json.loads(networks.read_text())
    networks.unlink()
    networks.write_text(json.dumps(record))  # the same, laid out in another way
    assert net_file(run, "whole_view") != path


def test_net_of_the_method_gives_its_own_dissimilarities():
    from deepmds_keras.networks import build_autoencoder, build_dissimilarity_net
    from experiments.lifting.pair_nets import net_dissimilarities

    model = DeepMDS(12)
    model.autoencoder_, model.dissimilarity_net_ = build_autoencoder(12), build_dissimilarity_net()
    views = np.random.default_rng(0).random((10, 12, 2))
    frontal = model.frontalise(views)
    found = net_dissimilarities(model.dissimilarity_net_, frontal, views)
    off_diagonal = ~np.eye(12, dtype=bool)
    assert np.allclose(found[:, off_diagonal], model.dissimilarities(views)[:, off_diagonal])


@pytest.mark.parametrize("whole_view", [False, True])
def test_nets_that_are_told_more_use_it_and_not_the_order_of_a_pair(whole_view):
    from experiments.lifting.pair_nets import build_pair_net

    net = build_pair_net(12, whole_view=whole_view)
    rng = np.random.default_rng(0)
    features, view = (np.float32(rng.random((6, n))) for n in (6, 24))
    ends = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [0, 4], [5, 6]])

    def found(ends, view):
        return np.asarray(net([features, ends, view][: len(net.inputs)], training=False))

    assert np.array_equal(found(ends, view), found(ends[:, ::-1], view))
    assert (found(ends, view) != found((ends + 1) % 12, view)).all()
    assert (found(ends, view) != found(ends, view[::-1])).all() == whole_view
