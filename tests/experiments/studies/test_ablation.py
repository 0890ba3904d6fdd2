"""Trainings with one part changed: what they change, and how they are collected."""

import json
import shutil

import numpy as np
import pytest
import runs

from deepmds_keras import normalise
from deepmds_keras.networks import count_trainable
from experiments.inputs import Faces
from experiments.presets import FULL, SMOKE, TINY
from experiments.records import write_json
from experiments.run import Run
from experiments.studies import ablation
from experiments.studies.seeds import seed_statistics
from experiments.studies.variant import VARIANTS, ablation_trainings, build_net, scores_file

SIZE = SMOKE.training_sizes[0]


def test_every_variant_is_trained_from_every_seed_and_has_its_own_file():
    run = Run("openhead", FULL, seed=3)
    trainings = ablation_trainings(run)
    assert {item.partition("-")[0] for item, _ in trainings} == {*VARIANTS}
    fewer = [(item.split("-")[1], seed) for item, seed in trainings if "-" in item]
    assert len(fewer) == 2 * len(FULL.training_sizes)
    assert all(int(size) < FULL.train_faces and seed == 3 for size, seed in fewer)
    assert len(trainings) - len(fewer) == (len(VARIANTS) - 2) * FULL.ablation_seeds
    assert len({scores_file(run, *training) for training in trainings}) == len(trainings)


def test_net_without_the_skip_connection_has_fewer_parameters():
    chain = VARIANTS["no_skip_connection"].chain
    with_it, without = (build_net(c, 0).count_params() for c in (None, chain))
    assert with_it - without == 20 * 20, "the fifth layer sees the fourth alone"


@pytest.mark.parametrize("name", [name for name in VARIANTS if "layers" in name])
def test_nets_of_other_depths_have_as_many_parameters_as_the_paper_allows(name):
    n_layers, units = VARIANTS[name].chain
    nets = (build_net((n_layers, units + more), 0) for more in (0, 1))
    below, above = map(count_trainable, nets)
    assert below < 3000 <= above


@pytest.fixture
def collected(tmp_path):
    """A run, and what is collected of its trainings, with values that seed and faces decide."""
    run = Run("openhead", SMOKE, build=tmp_path / "build")
    for item, seed in ablation_trainings(run):
        value = (1 + seed + float(item.partition("-")[2] or 0)) * 1e-4
        values = dict.fromkeys(("loss_train", "loss_inference", "mse", "mse_sem"), value)
        history = {"train": [3.0, 2.0], "inference": [4.0, 3.0]}
        write_json(scores_file(run, item, seed), {"values": values, "history": history})
    return run, *ablation.collect(run)


def test_table_shows_mean_and_spread_over_seeds_in_the_papers_unit(collected):
    run, metrics, losses = collected
    table = ablation.cells(seed_statistics(metrics, ["variant", "faces", "metric"]))
    expected = [f"{run.preset.train_faces:,}", "2", *["1.5 ± 0.7"] * 3]
    assert table.loc[VARIANTS["same_face"].title].tolist() == expected
    fewer = [f"{SIZE}", "1", *[f"{1 + SIZE}"] * 3]
    assert table.loc[VARIANTS["fewer_faces"].title].tolist() == fewer, "one seed has no s.d."
    first = losses[(losses["variant"] == "same_face") & (losses["seed"] == 0)]
    assert first[["epoch", "train", "inference"]].to_numpy().tolist() == [[1, 3, 4], [2, 2, 3]]


def test_curve_by_training_faces_ends_with_the_method_itself(collected, monkeypatch):
    run, metrics, _ = collected
    shapes = normalise(np.random.default_rng(0).random((run.preset.train_faces, 8, 3)))
    faces = Faces(shapes[..., :2], shapes, np.ones(len(shapes)), shapes, np.zeros(len(shapes)))
    monkeypatch.setattr(ablation, "load_faces", lambda run, part: faces)
    curve = ablation.training_curve(run, metrics)
    ours = curve[curve["method"] == "deep_mds"].set_index("value")["mse"] / 1e-4
    assert dict(ours) == pytest.approx({SIZE: 1 + SIZE, run.preset.train_faces: 1})
    assert {*curve["method"]} == {"mean_shape", "ridge", "deep_mds", "deep_mds_cosine"}


@pytest.mark.slow
def test_a_variant_changes_what_is_learnt(whole_bfm, tmp_path):
    shutil.copytree(whole_bfm / "build", tmp_path / "build")
    run = Run("openhead", TINY, build=tmp_path / "build")
    items = ("same_face", "no_autoencoder", f"fewer_faces-{TINY.training_sizes[0]}")
    for item in items:
        runs.succeed("studies.variant", tmp_path, item, "0")
    scores = [json.loads(scores_file(run, item, 0).read_text())["values"] for item in items]
    assert len({values["mse"] for values in scores}) == len(items)
