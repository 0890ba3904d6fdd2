"""Trainings with a part changed: what they change, how they are counted, that they go on."""

import json

import numpy as np
import pandas as pd
import pytest

from deepmds_keras import normalise
from deepmds_keras.networks import build_dissimilarity_net, count_trainable
from deepmds_keras.training import Recipe, train_dissimilarity_net
from experiments.presets import PAPER, SMOKE
from experiments.run import Run
from experiments.studies import ablation
from experiments.studies.variants import DEPTHS, FEWER_FACES, TITLES, VARIANTS, fewer_faces


@pytest.fixture
def run(tmp_path):
    return Run("openhead", SMOKE, build=tmp_path / "build", results=tmp_path / "results")


def test_every_variant_is_trained_from_every_seed_and_has_files_of_its_own(run):
    trainings = ablation.trainings(run)
    of_net = [item for item in trainings if item[0] in (*VARIANTS, *DEPTHS)]
    assert len(of_net) == (len(VARIANTS) + len(DEPTHS)) * SMOKE.ablation_seeds
    assert len(trainings) - len(of_net) == len(FEWER_FACES) * len(SMOKE.training_sizes)
    files = {
        variant.file(run, seed, kind) for variant, seed in trainings for kind in ("json", "npz")
    }
    assert len(files) == 2 * len(trainings)
    assert {variant.id for variant, _ in trainings} == TITLES.keys()


def test_fewer_faces_are_fewer_than_all():
    run = Run("openhead", PAPER)
    assert all(variant.faces < PAPER.train_faces for variant in fewer_faces(run))


@pytest.mark.slow
def test_shuffled_pairs_are_of_many_faces_and_train_the_net():
    """Faces of one shape each, a shuffled mini-batch of which holds pairs of nearly all."""
    rng = np.random.default_rng(0)
    shapes = normalise(rng.random((40, 12, 3)))
    views = np.float32(normalise(shapes[..., :2]))
    recipe = Recipe(3, 20)
    same, shuffled, again, other = (
        train_dissimilarity_net(views, shapes, recipe, shuffled=own, seed=seed)[1]
        for own, seed in ((False, 0), (True, 0), (True, 0), (True, 1))
    )
    assert shuffled == again
    assert same != shuffled != other
    assert shuffled["train"][-1] < shuffled["train"][0]


@pytest.mark.slow
def test_training_loss_of_shuffled_pairs_is_that_of_all_faces():
    """If one face differs from all others, mini-batches of one face show it in their losses."""
    rng = np.random.default_rng(0)
    shapes = np.repeat(normalise(rng.random((1, 12, 3))), 8, axis=0)
    views = np.float32(shapes[..., :2])
    shapes[0] *= 4
    losses = {}
    for shuffled in (False, True):
        recipe = Recipe(8, 1, learning_rate=0.0)  # each epoch is one mini-batch, nothing is learnt
        history = train_dissimilarity_net(views, shapes, recipe, shuffled=shuffled)[1]
        losses[shuffled] = np.array(history["train"])
    assert losses[False].max() > 4 * np.median(losses[False])
    assert losses[True].max() < 3 * np.median(losses[True])


def test_net_without_the_short_connection_has_fewer_parameters_and_learns():
    with_it, without = (
        build_dissimilarity_net(chain=chain).count_params() for chain in (None, (5, 20))
    )
    assert with_it - without == 20 * 20, "the fifth layer sees the fourth alone"


def test_nets_of_other_depths_have_as_many_parameters_as_the_paper_allows():
    for variant in DEPTHS:
        n_layers, units = variant.chain
        nets = (build_dissimilarity_net(chain=(n_layers, units + more)) for more in (0, 1))
        below, above = map(count_trainable, nets)
        assert below < 3000 <= above, variant.id


def write(run, value=lambda variant, seed: 1.0):
    for variant, seed in ablation.trainings(run):
        path = variant.file(run, seed)
        path.parent.mkdir(parents=True, exist_ok=True)
        values = dict.fromkeys(ablation.METRICS, value(variant, seed))
        history = {"train": [3.0, 2.0], "inference": [4.0, 3.0]}
        path.write_text(json.dumps({"values": values, "history": history}))


def test_spread_is_over_the_seeds_of_a_variant_and_a_number_of_faces(run):
    write(run, lambda variant, seed: seed + (variant.faces or 0))
    metrics, losses = ablation.collected(run)
    table = ablation.spread(metrics).set_index(["variant", "faces", "metric"])
    own = table.loc[("shuffled", SMOKE.train_faces, "mse")]
    assert (own["mean"], own["count"]) == (0.5, SMOKE.ablation_seeds)
    n = SMOKE.training_sizes[0]
    assert table.loc[("fewer_faces", n, "mse"), "mean"] == n
    first = losses[(losses["variant"] == "same_face") & (losses["seed"] == 0)]
    assert [*first["inference"]] == [4.0, 3.0]


def test_table_shows_mean_and_spread_in_the_papers_unit(run):
    write(run, lambda variant, seed: (1 + seed) * 1e-4)
    table = ablation.spread(ablation.collected(run)[0])
    rows = {row[0]: row[1:] for row in ablation.rows_of(table)}
    assert rows[TITLES["same_face"]] == [f"{SMOKE.train_faces:,}", "2", *["1.5 ± 0.7"] * 3]
    assert rows[TITLES["fewer_faces"]][2:] == ["1"] * 3, "one seed has no spread"
    assert r"Without the autoencoder & 4,800 & 2 & 1.5 $\pm$ 0.7" in ablation.latex(table)


def test_what_is_done_is_not_trained_again(run):
    write(run)
    assert ablation.train(run) == []


def test_curve_ends_with_the_method_itself(run, monkeypatch):
    write(run, lambda variant, seed: (variant.faces or 1) * 1.0)
    metrics = ablation.collected(run)[0]
    rng = np.random.default_rng(0)
    shapes = normalise(rng.random((SMOKE.train_faces, 8, 3)))

    class Few:
        def __init__(self, n):
            self.views, self.shapes = shapes[:n, :, :2], shapes[:n]
            self.unit_mm = np.ones(n)

        def __getitem__(self, faces):
            return self

    monkeypatch.setattr(
        ablation, "load_faces", lambda run, part: Few({"train": len(shapes), "test": 20}[part])
    )
    curve = ablation.training_curve(run, metrics)
    assert isinstance(curve, pd.DataFrame)
    ours = curve[curve["method"] == "ours"].set_index("value")["mse"]
    assert dict(ours) == {SMOKE.training_sizes[0]: SMOKE.training_sizes[0], SMOKE.train_faces: 1.0}
    assert {*curve["method"]} == {"mean_shape", "linear", "ours", "ours_stable"}
