"""The authors' networks on faces about the Basel mean: the mean, the faces, the table."""

import hashlib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import runs
from places import SHARED, committed
from writers.models import write_bfm2009

from deepmds_keras.errors import InputError
from deepmds_keras.geometry.alignment import align, procrustes
from deepmds_keras.landmarks import load_scheme
from experiments.presets import TINY
from experiments.records import read_manifest, steps_of
from experiments.released_weights import bfm_mean, score
from experiments.released_weights.bfm_mean import SCHEME, about_mean, read_mean
from experiments.run import Run

RELEASED = SHARED / "released" / "bfm"
needs_weights = pytest.mark.skipif(
    not RELEASED.is_dir(), reason="the authors' weights (../shared) are absent"
)


@pytest.fixture(scope="module")
def mean(head):
    """Another mean face: wider than that of the head, and elsewhere."""
    return head.mean[head.landmarks[SCHEME]] * (1.1, 1, 0.95) + (1, 2, 3)


@needs_weights
def test_the_mean_is_a_face_as_large_and_deep_as_the_basel_model(tmp_path):
    run = Run("openhead", TINY, build=tmp_path, authors=str(RELEASED))
    bfm_mean.main(run)
    digest = hashlib.sha256(bfm_mean.mean_file(run).read_bytes()).hexdigest()
    manifest = read_manifest(committed() / "results" / "released-weights")
    assert {step["inputs"].get("bfm72_mean.csv", digest) for step in steps_of(manifest)} == {digest}
    mean, scheme = read_mean(run), load_scheme(SCHEME)
    assert mean.shape == (72, 3) and mean[:, 2].argmax() == scheme.index("nose_tip")
    assert mean[:, 2].max() == pytest.approx(131.9, abs=0.5)  # of the model's file
    assert np.abs(mean[scheme.mirror] * (-1, 1, 1) - mean).max() < 3, "symmetric"


def test_without_weights_there_is_no_mean(tmp_path):
    with pytest.raises(InputError, match="AUTHORS must be the folder"):
        bfm_mean.main(Run("openhead", TINY, build=tmp_path))


def test_faces_vary_about_the_mean_as_those_of_the_model_do(head, mean):
    unmoved = head.at_landmarks(SCHEME)
    assert np.allclose(about_mean(head, 0.0, mean).sample(3, np.random.default_rng(0))[1], mean)
    sizes = []
    for scale in (1.0, 2.0):
        moved = about_mean(head, scale, mean)
        assert np.allclose(moved.mean, mean)
        unit = procrustes(unmoved.mean, mean, reflection=False).scale
        sizes.append(np.linalg.norm(moved.identity_basis_times_sd) / unit)
    assert np.allclose(sizes, np.linalg.norm(unmoved.identity_basis_times_sd) * np.array([1, 2]))


def test_answers_are_scored_on_the_same_faces(head, mean):
    run, rng = Run("openhead", replace(TINY, test_faces=200)), np.random.default_rng(0)
    off = mean + rng.normal(0, 2, (72, 3))
    model = about_mean(head, 1.0, mean)
    constant = SimpleNamespace(predict=lambda views, **_: np.stack([off] * len(views)))
    networks = {"released": constant}
    rows = pd.DataFrame(score.measure(run, networks, "paper", "openhead", 1.0, model))
    mse = rows.set_index("answer")["mse"]
    assert mse["deep_mds_constant"] == pytest.approx(mse["released"]), "it is a constant"
    assert mse["mean_shape"] < mse["random_face"] < 3 * mse["mean_shape"]
    assert mse["mean_shape"] < mse["released"]
    assert (rows["low"] <= rows["mse"]).all() and (rows["mse"] <= rows["high"]).all()
    unit = np.ptp(mean)
    assert mse["released"] - mse["mean_shape"] == pytest.approx(
        ((align(off, mean) - mean) ** 2).mean() / unit**2, rel=0.3
    )


@needs_weights
@pytest.mark.slow
def test_make_released_weights_prints_the_numbers_of_a_basel_model(tmp_path, mean):
    file = write_bfm2009(tmp_path, mean)
    steps = runs.make(
        "released-weights", tmp_path, "MODEL=bfm2009", f"DATA={file}", f"AUTHORS={RELEASED}"
    )
    assert [words[0] for words in steps] == ["released_weights.score"]
    folder = tmp_path / "results" / runs.PRESET / "bfm2009" / "released-weights"
    table = pd.read_csv(folder / "released.csv")
    assert {*table["answer"]} == {*score.NETS, "deep_mds_constant", "random_face", "mean_shape"}


@needs_weights
@pytest.mark.slow
def test_make_released_weights_trains_about_the_mean_and_draws(tmp_path):
    runs.make("released-weights", tmp_path, f"AUTHORS={RELEASED}")
    folder = tmp_path / "results" / runs.PRESET / "released-weights"
    trained = pd.read_csv(folder / "trained.csv")
    assert len(trained) == 3 * TINY.n_seeds * 4
    names = {"released.csv", "trained.csv", "table.tex", "manifest.json"}
    assert names <= {path.name for path in folder.iterdir()}
    assert {p.name for p in (folder / "figures").glob("*.png")} == {"released.png", "trained.png"}
