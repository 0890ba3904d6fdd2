"""The authors' networks on faces about the Basel mean: the mean, the faces, the table."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import runs
from places import SHARED
from writers.models import write_bfm2009

from data_gen.models.registry import load_model
from deepmds_keras.geometry.alignment import align, procrustes
from deepmds_keras.landmarks import load_scheme
from experiments.presets import TINY
from experiments.released_weights import score
from experiments.released_weights.bfm_mean import SCHEME, about_mean, extract_mean, read_mean
from experiments.run import Run

RELEASED = SHARED / "released" / "bfm"
needs_weights = pytest.mark.skipif(
    not RELEASED.is_dir(), reason="the authors' weights (../shared) are absent"
)


@needs_weights
def test_the_committed_mean_is_that_of_the_weights():
    files = (RELEASED / name for name in ("AE_occ2orth_BFM.h5", "deep_PAMI_occ_5000.h5"))
    assert np.abs(extract_mean(*files) - read_mean()).max() < 0.01


def test_the_mean_is_a_face_as_large_and_deep_as_the_basel_model():
    mean, scheme = read_mean(), load_scheme(SCHEME)
    assert mean.shape == (72, 3) and mean[:, 2].argmax() == scheme.index("nose_tip")
    assert mean[:, 2].max() == pytest.approx(131.9, abs=0.5)  # of the model's file
    assert np.abs(mean[scheme.mirror] * (-1, 1, 1) - mean).max() < 3, "symmetric"


def test_faces_vary_about_the_mean_as_those_of_the_model_do():
    model = load_model("openhead", None, SCHEME)
    unmoved = model.restrict(model.landmarks[SCHEME])
    assert np.allclose(about_mean(model, 0.0).sample(3, np.random.default_rng(0))[1], read_mean())
    sizes = []
    for scale in (1.0, 2.0):
        moved = about_mean(model, scale)
        assert np.allclose(moved.mean, read_mean())
        unit = procrustes(unmoved.mean, read_mean(), reflection=False).scale
        sizes.append(np.linalg.norm(moved.identity_basis_times_sd) / unit)
    assert np.allclose(sizes, np.linalg.norm(unmoved.identity_basis_times_sd) * np.array([1, 2]))


class MeanNetwork:
    """Returns a shape that is off by the same for all views."""

    def __init__(self, shape):
        self.shape = shape

    def predict(self, views, check_orientation):
        return np.tile(self.shape, (len(views), 1, 1))


def test_answers_are_scored_on_the_same_faces():
    run, rng = Run("openhead", replace(TINY, test_faces=200)), np.random.default_rng(0)
    off = read_mean() + rng.normal(0, 2, (72, 3))
    model = about_mean(load_model("openhead", None, SCHEME), 1.0)
    networks = {"released": MeanNetwork(off)}
    rows = pd.DataFrame(score.measure(run, networks, "paper", "openhead", 1.0, model))
    mse = rows.set_index("answer")["mse"]
    assert mse["deep_mds_constant"] == pytest.approx(mse["released"]), "it is a constant"
    assert mse["mean_shape"] < mse["random_face"] < 3 * mse["mean_shape"]
    assert mse["mean_shape"] < mse["released"]
    assert (rows["low"] <= rows["mse"]).all() and (rows["mse"] <= rows["high"]).all()
    mean = align(off, read_mean())
    assert mse["released"] - mse["mean_shape"] == pytest.approx(
        ((mean - read_mean()) ** 2).mean() / 207**2, rel=0.3
    )


@needs_weights
@pytest.mark.slow
def test_make_released_weights_prints_the_numbers_of_a_basel_model(tmp_path):
    file = write_bfm2009(tmp_path, read_mean())
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
