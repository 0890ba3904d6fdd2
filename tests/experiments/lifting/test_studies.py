"""The studies: their tables from made-up errors, and each at the smallest size."""

import shutil

import numpy as np
import pandas as pd
import pytest
import runs
from places import SHARED

from experiments.inputs import load_faces
from experiments.lifting import hard, transfer
from experiments.lifting.train import lifting_networks
from experiments.lifting.views import CONDITIONS
from experiments.methods import load, predict
from experiments.presets import PAPER, TINY
from experiments.run import Run
from experiments.scoring.scores import score


@pytest.fixture(scope="module")
def errors():
    """Of 40 faces: twice those of the limit, in one condition from two seeds."""
    rng, parts = np.random.default_rng(0), []
    for condition in CONDITIONS:
        best = 1e-5 * rng.uniform(1, 2, 40)
        given = {"ours_stable": [1e-3 * np.ones(40)] if not condition.missing else []}
        given |= {"lifting": [2 * best, 2.1 * best][: 1 + (condition.id == "hard_1")]}
        for method, own in (given | {"limit": [best]}).items():
            for seed, values in enumerate(own):
                yaw = np.linspace(0, 59, 40)
                rows = {"mse": values, "times_limit": values / best, "seed": seed, "yaw": yaw}
                rows |= {"within_1_sd": np.nan, "within_2_sd": np.nan}
                parts.append(pd.DataFrame(rows).assign(method=method, condition=condition.id))
    return pd.concat(parts)


def test_tables_have_a_mean_over_seeds_and_a_reason_for_what_is_empty(errors):
    table = hard.summarise(errors).set_index(["metric", "method", "condition"])
    assert {*table.index.levels[0]} == {"mse", "times_limit"}, "what nobody measured has no row"
    seeded = table.loc["times_limit", "lifting", "hard_1"]
    assert seeded["n_seeds"] == 2 and seeded["mean"] == pytest.approx(2.05)
    assert seeded["std"] == pytest.approx(0.1 / 2**0.5)
    assert seeded["standard_error"] == pytest.approx(0, abs=1e-12)
    own = errors.query("method == 'limit' and condition == 'hard_3'")["mse"]
    mse = table.loc["mse", "limit", "hard_3"]
    assert mse["mean"] == pytest.approx(own.mean())
    assert mse["standard_error"] == pytest.approx(own.std() / 40**0.5)
    empty = table.index[table["mean"].isna()]
    assert {*empty} == {("mse", "ours_stable", c.id) for c in CONDITIONS if c.missing}
    cells = hard.cells(table.reset_index())
    assert cells.loc["Deep-MDS, cosine schedule"].tolist() == 4 * ["1,000"] + 3 * ["–"]


def test_every_condition_has_its_network_and_one_has_three_seeds():
    names = lifting_networks(Run("openhead", PAPER), "hard")
    assert len({*names}) == len(names) == 4 + 5 + 2
    assert sum(name.startswith("hard-lifting-hard_1-") for name in names) == 3


@pytest.mark.parametrize("whole_view", [False, True])
def test_nets_with_more_input_use_it_and_not_the_order_of_a_pair(whole_view):
    from experiments.lifting.pair_nets import build_pair_net

    net = build_pair_net(12, whole_view=whole_view)
    rng = np.random.default_rng(0)
    features, view = (np.float32(rng.random((6, n))) for n in (6, 24))
    ends = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [0, 4], [5, 6]])

    def distances(ends, view):
        return np.asarray(net([features, ends, view][: len(net.inputs)], training=False))

    assert np.array_equal(distances(ends, view), distances(ends[:, ::-1], view))
    assert (distances(ends, view) != distances((ends + 1) % 12, view)).all()
    assert (distances(ends, view) != distances(ends, view[::-1])).all() == whole_view


def test_components_are_those_of_the_shapes():
    rng = np.random.default_rng(0)
    mean, known = rng.normal(size=(6, 3)), rng.normal(size=(2, 6, 3)) * 10
    shapes = mean + np.tensordot(rng.standard_normal((500, 2)), known, 1)
    found, basis = transfer.principal_components(shapes)
    flat, own = (shapes - shapes.mean(0)).reshape(500, -1), basis.reshape(len(basis), -1)
    assert np.allclose(found, shapes.mean(0)) and len(basis) == 2
    assert np.allclose(own.T @ own, flat.T @ flat / 500)


def test_landmarks_that_a_model_lacks_are_filled_in_for_methods_that_need_them():
    rng = np.random.default_rng(0)
    shapes = rng.normal(size=(6, 3)) + 0.1 * rng.normal(size=(200, 6, 3))
    views = shapes[..., :2].copy()
    views[:, 5] = views[:, 0] + views[:, 1] - views[:, 2]
    test = views[:20] * 40 + 900
    lacking = test.copy()
    lacking[:, 5] = np.nan

    class Lifter:
        def predict(self, views, **_):
            assert np.isnan(views[:, 5]).all(), "which a lifter need not have"
            return np.zeros((len(views), 6, 3))

    trained = transfer.Trained(views, shapes, Lifter())
    assert np.allclose(trained._filled(lacking), test)
    assert np.isfinite(trained.predict(lacking, 0.0)["linear"]).all()


@pytest.mark.skipif(not (SHARED / "sfm").is_dir(), reason="../shared/sfm is absent")
def test_faces_of_the_surrey_model_are_tested_where_it_is_given():
    run = Run("openhead", TINY, sfm=str(SHARED / "sfm"))
    views, shapes = transfer.tested_faces(run, transfer.SURREY, 0.0)
    noisy, same = transfer.tested_faces(run, transfer.SURREY, 1.0)
    np.testing.assert_array_equal(shapes, same)
    assert 0.8 < np.nanstd(noisy - views) < 1.2
    assert np.isnan(views).any(2).sum(1).tolist() == [2] * TINY.test_faces
    known = np.load(SHARED / "sfm" / "sfm49.npz")
    mean = shapes[:, known["ibug"] - 18].mean(0)
    assert np.abs(mean - known["mean"]).max() < 15, "of the same faces, in millimetres"


@pytest.fixture(scope="module")
def folder(whole_bfm, tmp_path_factory):
    folder = tmp_path_factory.mktemp("lifting")
    shutil.copytree(whole_bfm / "build", folder / "build")
    data = [f"DATA={SHARED / 'ict-facekit'}"] if (SHARED / "ict-facekit").exists() else []
    runs.make("lifting", folder, *data)
    return folder


def table_of(folder, study):
    return pd.read_csv(runs.results(folder, f"lifting/{study}") / "table.csv")


@pytest.mark.slow
def test_every_method_is_above_the_limit(folder):
    table = table_of(folder, "hard").query("metric == 'times_limit' and method != 'limit'")
    assert (table["mean"] > 1).all() and len(table) == 4 * 7 + 4 + 7


@pytest.mark.slow
def test_steps_of_the_anatomy_replace_one_part_and_nothing_else(folder):
    run = Run("openhead", TINY, build=folder / "build", jobs=1)
    test = load_faces(run, "test")[: TINY.audited_faces]
    errors = table_of(folder, "anatomy").set_index(["step", "embedding"])["mse"]
    ours, lifted = (
        score(predict(load(run, method), test.views), test).mse.mean()
        for method in ("ours_stable", "lifting")
    )
    assert errors["deep_mds", "non_metric"] == pytest.approx(ours, rel=1e-3)
    for embedding in ("non_metric", "metric"):  # of Euclidean distances either gives the shape back
        assert errors["lifting", embedding] == pytest.approx(lifted, rel=1e-2)
        assert errors["true_distances", embedding] < 1e-12
    assert errors["limit", "none"] < lifted < errors["mean_shape", "none"]


@pytest.mark.slow
def test_tests_of_the_transfer_differ_by_the_noise_alone(folder):
    for (_, model), rows in table_of(folder, "transfer").groupby(["trained", "tested"]):
        errors = rows.pivot(index="noise_mm", columns="method", values="mse")
        assert errors.index.tolist() == [*transfer.NOISES_MM]
        assert errors["mean_shape"].nunique() == 1, "the faces are the same"
        if model == "openhead":
            assert errors["lifting"].is_monotonic_increasing
            assert errors.loc[0, "lifting"] < errors.loc[0, "linear"] < errors.loc[0, "mean_shape"]
