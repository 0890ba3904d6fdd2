"""The studies: their tables from made-up errors, and each at the smallest size."""

import shutil
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import runs
from places import SHARED
from scipy.spatial.distance import pdist

from deepmds_keras.baselines.closed_form import MeanShape
from deepmds_keras.baselines.map_fit import principal_components
from deepmds_keras.geometry.units import normalise
from experiments.inputs import load_faces
from experiments.lifting import component_ablation, hard, transfer
from experiments.lifting.train import lifting_networks
from experiments.lifting.train_pairs import views_of_pairs
from experiments.lifting.variants import VARIANTS
from experiments.lifting.views import CONDITIONS
from experiments.methods import load, predict
from experiments.presets import FULL, TINY
from experiments.run import Run
from experiments.scoring.scores import score


@pytest.fixture(scope="module")
def errors():
    """Of 40 faces: twice those of the lower bound, in one condition from two seeds."""
    rng, parts = np.random.default_rng(0), []
    for condition in CONDITIONS:
        best = 1e-5 * rng.uniform(1, 2, 40)
        given = {"deep_mds_cosine": [1e-3 * np.ones(40)] if not condition.missing else []}
        given |= {"landmark_lifter": [2 * best, 2.1 * best][: 1 + (condition.id == "hard_1")]}
        for method, by_seed in (given | {"lower_bound": [best]}).items():
            for seed, values in enumerate(by_seed):
                yaw = np.linspace(0, 59, 40)
                rows = {"mse": values, "times_lower_bound": values / best, "seed": seed, "yaw": yaw}
                rows |= {"within_1_sd": np.nan, "within_2_sd": np.nan}
                parts.append(pd.DataFrame(rows).assign(method=method, condition=condition.id))
    return pd.concat(parts)


def test_tables_have_a_mean_over_seeds_and_a_reason_for_what_is_empty(errors):
    table = hard.summarise(errors).set_index(["metric", "method", "condition"])
    assert {*table.index.levels[0]} == {"mse", "times_lower_bound"}, (
        "what nobody measured has no row"
    )
    seeded = table.loc["times_lower_bound", "landmark_lifter", "hard_1"]
    assert seeded["n_seeds"] == 2 and seeded["mean"] == pytest.approx(2.05)
    assert seeded["std"] == pytest.approx(0.1 / 2**0.5)
    assert seeded["standard_error"] == pytest.approx(0, abs=1e-12)
    limit = errors.query("method == 'lower_bound' and condition == 'hard_3'")["mse"]
    mse = table.loc["mse", "lower_bound", "hard_3"]
    assert mse["mean"] == pytest.approx(limit.mean())
    assert mse["standard_error"] == pytest.approx(limit.std() / 40**0.5)
    empty = table.index[table["mean"].isna()]
    assert {*empty} == {("mse", "deep_mds_cosine", c.id) for c in CONDITIONS if c.missing}
    cells = hard.cells(table.reset_index())
    assert cells.loc["Deep-MDS, cosine schedule"].tolist() == 4 * ["1,000"] + 3 * ["–"]


def test_normal_errors_are_within_their_sd_as_often_as_tables_say():
    rng = np.random.default_rng(0)
    sd = rng.uniform(0.5, 3, (4, 5000, 3))
    truth = rng.standard_normal(sd.shape)
    within = hard.coverage(truth + sd * rng.standard_normal(sd.shape), sd, truth)
    np.testing.assert_allclose(within["within_1_sd"], 0.6827, atol=0.02)
    np.testing.assert_allclose(within["within_2_sd"], 0.9545, atol=0.01)


def test_every_condition_has_its_network_and_one_has_three_seeds():
    names = lifting_networks(Run("openhead", FULL), "hard")
    assert len({*names}) == len(names) == 4 + 5 + 2
    assert sum(name.startswith("hard-landmark_lifter-hard_1-") for name in names) == 3


@pytest.mark.parametrize("name", VARIANTS)
def test_nets_use_their_inputs_and_not_the_order_of_a_pair(name):
    from experiments.lifting.pair_nets import build_pair_net

    variant, rng = VARIANTS[name], np.random.default_rng(0)
    net = build_pair_net(12, variant)
    features, view = (np.float32(rng.random((6, n))) for n in (6, 24))
    ends = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [0, 4], [5, 6]])

    def distances(features=features, ends=ends, view=view):
        inputs = [features, ends, view][: len(net.inputs)]
        return np.asarray(net(inputs if len(inputs) > 1 else features, training=False))

    assert (distances() != distances(features[::-1])).all()
    assert np.array_equal(distances(), distances(ends=ends[:, ::-1]))
    assert (distances() != distances(ends=(ends + 1) % 12)).all() == variant.identity
    assert (distances() != distances(view=view[::-1])).all() == variant.whole_view
    assert net.get_layer("hidden_1").units == variant.units


def test_each_variant_of_the_component_ablation_differs_from_another_in_one_thing():
    for name in [*VARIANTS][1:]:
        others = (vars(VARIANTS[other]) for other in VARIANTS if other != name)
        apart = [sum(other[k] != v for k, v in vars(VARIANTS[name]).items()) for other in others]
        assert min(apart) == 1, name


def test_pairs_are_of_the_view_that_a_variant_names():
    rng = np.random.default_rng(0)
    views, shapes = rng.random((3, 6, 2)), rng.random((3, 6, 3))
    faces = SimpleNamespace(views=views, shapes=shapes)
    seen = {k: views_of_pairs(v, faces, lambda views: 5 + views) for k, v in VARIANTS.items()}
    assert np.array_equal(seen["not_rescaled"], 5 + views)
    assert np.allclose(seen["cosine"], normalise(views))
    assert np.array_equal(seen["true_frontal"], normalise(shapes[..., :2]))


@pytest.mark.parametrize("shuffled", [False, True])
def test_mini_batches_are_of_one_face_or_of_all(shuffled, monkeypatch):
    from deepmds_keras.networks import build_dissimilarity_net
    from deepmds_keras.training import Recipe
    from experiments.studies import pair_training

    shape = np.random.default_rng(0).random((6, 3))
    shapes, trainings = np.arange(1, 21)[:, None, None] * shape, []

    def train_by_epoch(model, batches, *more):
        epochs = [[pairs[1].ravel() for pairs in batches(epoch)["x"]] for epoch in (0, 1)]
        trainings.append(np.array(epochs))

    monkeypatch.setattr(pair_training, "train_by_epoch", train_by_epoch)
    for seed in (0, 0, 1):
        net = pair_training.PairNet(build_dissimilarity_net(), Recipe(1, 20), seed, shuffled)
        net.fit(shapes[..., :2], shapes[..., :2], shapes)
    (distances, second), again, other = trainings
    assert (again == [distances, second]).all()
    assert (distances != second).any() and (distances != other[0]).any()
    ratios = distances[:, :, None] / pdist(shape)  # at its own pair the number of the face
    off = np.abs(ratios - ratios.round())
    faces = np.take_along_axis(ratios, off.argmin(2)[..., None], 2)[..., 0].round()
    assert off.min(2).max() < 1e-4 and {*faces.ravel()} == {*range(1, 21)}
    for of_batch in faces:
        assert len({*of_batch}) > 5 if shuffled else len({*of_batch}) == 1


def test_components_are_those_of_the_shapes():
    rng = np.random.default_rng(0)
    mean, known = rng.normal(size=(6, 3)), rng.normal(size=(2, 6, 3)) * 10
    shapes = mean + np.tensordot(rng.standard_normal((500, 2)), known, 1)
    mean, basis = principal_components(shapes, 0.3)
    flat, components = (shapes - shapes.mean(0)).reshape(500, -1), basis.reshape(len(basis), -1)
    assert np.allclose(mean, shapes.mean(0)) and len(basis) == 2
    assert np.allclose(components.T @ components, flat.T @ flat / 500)


def test_landmarks_that_a_model_lacks_are_filled_in_for_methods_that_need_them():
    rng = np.random.default_rng(0)
    shapes = rng.normal(size=(9, 3)) + 0.1 * rng.normal(size=(200, 9, 3))
    views = shapes[..., :2].copy()
    views[:, 5] = views[:, 0] + views[:, 1] - views[:, 2]
    test = views[:20] * 40 + 900
    lacking = test.copy()
    lacking[:, 5] = np.nan

    class Lifter:
        def predict(self, views, **_):
            assert np.isnan(views[:, 5]).all(), "which a lifter need not have"
            return np.zeros((len(views), 9, 3))

    trained = transfer.Trained(views, 40 * shapes, Lifter(), None, MeanShape())
    assert np.allclose(trained._filled(lacking), test)
    truth = 40 * shapes[:20]
    truth[:, 5] = np.nan
    predicted = trained.predict(lacking, 0.0, truth)
    assert np.isfinite([*predicted.values()]).all() and {"aldrian_hindsight", "map_learnt"} <= {
        *predicted
    }


@pytest.mark.skipif(not (SHARED / "sfm").is_dir(), reason="../shared/sfm is absent")
def test_faces_of_the_surrey_model_are_tested_where_it_is_given():
    pytest.importorskip("eos", reason="eos-py has no wheel here")
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
    table = table_of(folder, "hard").query(
        "metric == 'times_lower_bound' and method != 'lower_bound'"
    )
    assert (table["mean"] > 1).all() and len(table) == 6 * 7 + 4 + 7


@pytest.mark.slow
def test_steps_of_the_component_ablation_are_scored_on_all_test_faces_and_seeds(folder):
    run = Run("openhead", TINY, build=folder / "build", jobs=1)
    test = load_faces(run, "test")
    table = table_of(folder, "component-ablation").set_index(["step", "embedding"])
    assert {*table.index.levels[0]} == {*component_ablation.STEPS}
    ours, lifted = (
        score(predict(load(run, method), test.views), test).mse.mean()
        for method in ("deep_mds", "landmark_lifter")
    )
    seeds = pd.read_csv(runs.results(folder, "lifting/component-ablation") / "seeds.csv")
    first = seeds[seeds["seed"] == 0].set_index(["step", "embedding"])["mse"]
    # The same faces, weights at the start and mini-batches, by another input pipeline.
    assert first["constant", "non_metric"] == pytest.approx(ours, rel=0.05)
    for embedding in ("non_metric", "metric"):  # of Euclidean distances either gives the shape back
        assert first["landmark_lifter", embedding] == pytest.approx(lifted, rel=1e-2)
        assert first["true_distances", embedding] < 1e-12
    assert first["lower_bound", "none"] < lifted < first["mean_shape", "none"]
    assert (table.loc["cosine", "n_seeds"] == TINY.n_seeds).all()


@pytest.mark.slow
def test_tests_of_the_transfer_differ_by_the_noise_alone(folder):
    for (_, model), rows in table_of(folder, "transfer").groupby(["trained", "tested"]):
        errors = rows.pivot(index="noise_mm", columns="method", values="mse")
        assert errors.index.tolist() == [*transfer.NOISES_MM]
        assert errors["mean_shape"].nunique() == 1, "the faces are the same"
        if model == "openhead":
            assert errors["landmark_lifter"].is_monotonic_increasing
            assert (
                errors.loc[0, "landmark_lifter"]
                < errors.loc[0, "ridge"]
                < errors.loc[0, "mean_shape"]
            )
