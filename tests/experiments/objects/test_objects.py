"""The methods on other objects: which shapes are read, held out and seen, and how errors count."""

import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import runs
from scipy.spatial.transform import Rotation

from deepmds_keras.errors import InputError
from experiments.objects import table
from experiments.objects.shapes import METHODS, OBJECTS, SEQUENCES, read_shapes, views_of
from experiments.objects.train import errors
from experiments.presets import TINY
from experiments.run import Run


@pytest.fixture
def folder(tmp_path):
    rng = np.random.default_rng(0)
    for number, name in enumerate(OBJECTS):
        mean, basis = rng.normal(0, 30, (8 + number, 3)), rng.normal(0, 4, (2, 8 + number, 3))
        points = mean + np.tensordot(rng.standard_normal((30, 2)), basis, 1) + 500
        np.savez(tmp_path / f"{name}.npz", points=np.float32(points))
    return tmp_path


@pytest.fixture
def run(folder):
    return replace(Run(), preset=TINY, objects=str(folder))


def test_landmarks_that_few_shapes_have_are_left_out_then_shapes_that_lack_one(folder):
    points = np.load(folder / "chairs.npz")["points"]
    points[:20, 5] = np.nan
    points[3, 2, 1] = np.nan
    np.savez(folder / "chairs.npz", points=points)
    shapes = read_shapes(folder / "chairs.npz")
    assert shapes.shape == (29, 7, 3)
    np.testing.assert_allclose(shapes.mean(1), 0, atol=1e-6)
    np.testing.assert_allclose((shapes**2).sum(2).mean(1), 1)


def test_shapes_that_come_again_turned_are_read_once(folder):
    points = np.load(folder / "jaws.npz")["points"]
    turns = Rotation.random(len(points), np.random.default_rng(0)).as_matrix()
    np.savez(folder / "again.npz", points=np.concatenate([points, points @ np.float32(turns)]))
    np.testing.assert_array_equal(
        read_shapes(folder / "again.npz"), read_shapes(folder / "jaws.npz")
    )


@pytest.mark.parametrize(
    "arrays",
    [{"shapes": np.ones((20, 9, 3))}, {"points": np.ones((20, 9, 2))},
     {"points": np.ones((20, 9, 3), int)}, {"points": np.full((20, 9, 3), np.nan)},
     {"points": np.random.default_rng(0).random((9, 9, 3))}],
)  # fmt: skip
def test_files_without_enough_shapes_are_refused(tmp_path, arrays):
    np.savez(tmp_path / "chairs.npz", **arrays)
    with pytest.raises(InputError, match="chairs.npz.* must"):
        read_shapes(tmp_path / "chairs.npz")


@pytest.mark.parametrize("name", OBJECTS)
def test_no_shape_is_seen_in_training_and_test_and_noise_is_all_that_differs(run, name):
    (train, test), (noisy, _) = views_of(run, name, 0, 0.0), views_of(run, name, 0, 0.1)
    known, held = ({shape.tobytes() for shape in part.shapes} for part in (train, test))
    assert not known & held and len(known | held) == 30
    assert len(held) == round(30 * OBJECTS[name])
    assert np.std(noisy.views - train.views) == pytest.approx(0.1, rel=0.15)
    others = {shape.tobytes() for shape in views_of(run, name, 1, 0.0)[1].shapes}
    assert (others == held) == (name in SEQUENCES)
    sizes = (train.views**2).sum(2).mean(1)
    assert sizes.max() <= 1 + 1e-6 and sizes.min() > 0.1


@pytest.mark.parametrize("name", ["chairs", "drink"])
def test_which_way_a_thing_stood_is_no_variance(run, folder, name):
    def variances():
        train, test = views_of(run, name, 0, 0.0)
        return [np.mean((part.shapes - train.shapes.mean(0)) ** 2) for part in (train, test)]

    before = variances()
    points = np.load(folder / f"{name}.npz")["points"]
    turns = Rotation.random(len(points), np.random.default_rng(1)).as_matrix()
    np.savez(folder / f"{name}.npz", points=points @ np.float32(turns))
    assert variances() == pytest.approx(before, rel=1e-3)


def test_errors_are_squared_distances_whatever_turn_size_place_and_side():
    rng = np.random.default_rng(0)
    truth = rng.normal(size=(4, 9, 3))
    truth -= truth.mean(1, keepdims=True)
    turn = Rotation.random(random_state=0).as_matrix() * [1, 1, -1]
    np.testing.assert_allclose(errors(3 * truth @ turn + 7, truth), 0, atol=1e-12)
    off = 0.01 * rng.normal(size=truth.shape)
    assert errors(truth + off, truth).mean() == pytest.approx(3e-4, rel=0.4)


def test_medians_are_over_seeds():
    rows = [
        {"object": "chairs", "noise": 0.0, "method": "ridge", "seed": seed, "error": error,
         "frontal_share": np.nan, "n_views": 9, "n_landmarks": 8}
        for seed, error in enumerate([3.0, 1.0, 2.5])
    ]  # fmt: skip
    (row,) = table.summarise(pd.DataFrame(rows)).to_dict("records")
    assert (row["median"], row["lowest"], row["highest"], row["n_seeds"]) == (2.5, 1.0, 3.0, 3)


@pytest.mark.slow
def test_every_method_is_measured_on_every_object(folder, tmp_path):
    """From the first seed. The others take as long each; here they have the scores of the first."""
    *trainings, (step, *options) = runs.plan("objects", tmp_path, f"OBJECTS={folder}")
    seeds = {words[2] for words in trainings}
    for words in trainings:
        if words[2] == "0":
            runs.succeed(words[0], tmp_path, *words[1:])
    for scores in [*(runs.work(tmp_path, "bfm") / "objects").glob("*-seed0.csv")]:
        for seed in seeds - {"0"}:
            shutil.copy(scores, scores.with_name(scores.name.replace("seed0", f"seed{seed}")))
    runs.succeed(step, tmp_path, *options[: options.index("--record")])
    measured = pd.read_csv(tmp_path / "results" / "tiny" / "objects" / "table.csv")
    cells = measured.set_index(["object", "noise", "method"])["median"]
    assert len(cells) == len(OBJECTS) * 2 * len(METHODS) and np.isfinite(cells).all()
    exact = cells.unstack("method").xs(0.0, level="noise")
    assert (exact["map_learnt"] < exact["mean_shape"]).all()
