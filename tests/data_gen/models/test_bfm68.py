"""The Basel Face Model at 68 landmarks from a checkout of 3DDFA: known values, bad files."""

import pickle
from contextlib import suppress

import numpy as np
import pandas as pd
import pytest
import runs
from places import SHARED
from writers.models import write_3ddfa

from data_gen.landmarks import load_vertices
from data_gen.models.bfm68 import load_bfm68
from data_gen.models.registry import find_model, load_model, model_files
from deepmds_keras.errors import InputError
from experiments.inputs import face_model
from experiments.released_weights.bfm_mean import FILES, extract_mean
from experiments.run import run_of_variables

CHECKOUT = SHARED / "3ddfa"


@pytest.fixture
def checkout(tmp_path, head):
    return write_3ddfa(tmp_path / "3DDFA", head)


def test_a_checkout_gives_the_model_that_is_in_it(checkout, head):
    model, known = load_bfm68(checkout), head.at_landmarks("ibug68")
    offsets = known.identity_basis_times_sd
    np.testing.assert_allclose(model.mean, known.mean, atol=1e-4)
    np.testing.assert_allclose(model.identity_basis_times_sd, offsets[:40], atol=1e-4)
    np.testing.assert_allclose(model.expression_basis, 2 * offsets[40:50], atol=1e-4)
    mean_expression = 0.005 + 0.5 * offsets[40:50].sum(0)
    np.testing.assert_allclose(model.expression_mean, mean_expression, atol=1e-4)
    np.testing.assert_allclose(model.component_sd, np.linspace(900, 100, 40), rtol=1e-6)
    np.testing.assert_array_equal(model.landmarks["ibug51"], np.arange(17, 68))


def test_it_is_found_in_the_checkout_or_a_folder_above_and_read_whole(checkout):
    for path in (checkout, checkout.parent, checkout / "train.configs" / "u_shp.npy"):
        assert find_model("bfm68", path) == checkout
    before = load_model("bfm68", checkout, "ibug68").sha256
    for file in model_files("bfm68", checkout):
        content = file.read_bytes()
        file.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
        with suppress(InputError):
            assert load_model("bfm68", checkout, "ibug68").sha256 != before, file
        file.write_bytes(content)


def test_a_scale_multiplies_what_differs_from_the_mean_and_names_the_folders(checkout):
    given = {"MODEL": "bfm68", "DATA": str(checkout)}
    runs = [run_of_variables(given | more) for more in ({}, {"BFM_SCALE": "1.5"})]
    one, wider = map(face_model, runs)
    identity = np.random.default_rng(0).standard_normal(40)
    offset = one.shape(identity) - one.mean
    np.testing.assert_allclose(wider.shape(identity) - wider.mean, 1.5 * offset)
    np.testing.assert_allclose(wider.component_sd, 1.5 * one.component_sd)
    assert runs[1].experiment_results("bfm").parts[-2:] == ("bfm68", "bfm-scale1.5")
    assert runs[0].work != runs[1].work


def write(path, content):
    if path.suffix == ".pkl":
        path.write_bytes(pickle.dumps(content))
    else:
        (np.savetxt if path.suffix == ".txt" else np.save)(path, content)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("train.configs/u_shp.npy", np.zeros((68, 3))),
        ("train.configs/u_exp.npy", np.zeros((3 * 53_215, 1), complex)),
        ("train.configs/u_exp.npy", np.full((3 * 53_215, 1), np.nan)),
        ("train.configs/keypoints_sim.npy", np.arange(204)[::-1].copy()),
        ("train.configs/keypoints_sim.npy", np.arange(204) + 3 * 53_215),
        ("train.configs/param_whitening.pkl", {"param_std": np.ones(62)}),
        ("train.configs/param_whitening.pkl", dict.fromkeys(("param_mean", "param_std"), [1] * 60)),
        ("train.configs/param_whitening.pkl", ["param_std"]),
        ("c++/weights/w_shp_base.txt", np.ones((204, 39))),
        ("c++/weights/w_exp_base.txt", np.ones((159, 10))),
    ],
)
def test_damaged_files_are_refused_by_name(checkout, name, content):
    write(checkout / name, content)
    with pytest.raises(InputError, match="3DDFA.* must"):
        load_bfm68(checkout)


def test_what_is_missing_is_named(checkout, tmp_path):
    (checkout / "c++" / "weights" / "w_exp_base.txt").unlink()
    with pytest.raises(InputError, match="w_exp_base.txt.* must"):
        load_bfm68(checkout)
    with pytest.raises(InputError, match="DATA= must .*cleardusk/3DDFA"):
        find_model("bfm68", tmp_path / "c++")
    with pytest.raises(InputError, match="must hold all files of bfm68.* none at .*w_exp_base.txt"):
        model_files("bfm68", checkout)


@pytest.mark.skipif(not CHECKOUT.is_dir(), reason="../shared/3ddfa is absent")
def test_the_real_mean_is_where_the_authors_weights_have_it():
    """A vertex of the whole model has at most 275 before it that 3DDFA lacks, none twice."""
    mean = extract_mean(*(SHARED / "released" / "bfm" / name for name in FILES))
    model = load_bfm68(CHECKOUT)
    right, left = model.mean[[36, 45]]
    assert np.linalg.norm(right - left) == pytest.approx(86.3, abs=0.1)
    whole = np.load(CHECKOUT / "train.configs" / "u_shp.npy").reshape(-1, 3) / 1000
    numbers = load_vertices("bfm72").vertices["bfm2009"]
    candidates = np.clip(numbers[:, None] - np.arange(276), 0, len(whole) - 1)
    off = np.linalg.norm(whole[candidates] - mean[:, None], axis=2)
    assert off.min(1).max() < 1.2 and np.median(off.min(1)) < 0.8


@pytest.mark.slow
def test_the_table_of_the_landmark_methods_is_made_on_it(checkout, tmp_path):
    given = ("MODEL=bfm68", f"DATA={checkout}", "MOBILEFACE=no", "BFM_SCALE=2")
    runs.make("reproduce-bfm", tmp_path, *given)
    folder = tmp_path / "results" / "tiny" / "bfm68" / "bfm-scale2"
    table = pd.read_csv(folder / "table.csv").set_index(["metric", "method"])
    measured = table.loc["mse", "mean"].dropna()
    assert {"mean_shape", "ridge", "zhao", "aldrian", "deep_mds", "landmark_lifter"} <= {
        *measured.index
    }
    assert measured["aldrian"] < measured["mean_shape"]
    assert (table["n_landmarks"] == 68).all()
    assert "Depth correlation (of 68)" in (folder / "table.tex").read_text()


@pytest.mark.slow
def test_the_scales_share_the_networks_of_the_main_table(checkout, tmp_path):
    """More variation is more error for the mean shape, in the square; methods are scored alike."""
    given = ("MODEL=bfm68", f"DATA={checkout}", "SEEDS=2")
    runs.make("scales", tmp_path, *given)
    folder = tmp_path / "results" / "tiny" / "bfm68" / "scales"
    table = pd.read_csv(folder / "table.csv").set_index(["scale", "method"])
    assert table.loc[(1, "deep_mds"), "n_seeds"] == 2
    errors = table["mse"].unstack()["mean_shape"]
    assert errors[2] / errors[1] == pytest.approx(4, rel=0.2)
    assert (table.xs("mean_shape", level="method")["slope"] == 0).all()
    assert (table.xs("mean_shape", level="method")["over_mean_shape"] == 1).all()
    assert table.loc[(1, "aldrian"), "slope"] > table.loc[(1, "deep_mds_constant"), "slope"]
    trained = {path.parent.name for path in tmp_path.rglob("networks")}
    assert any("scale1.5" in name for name in trained) and not any("scale1-" in n for n in trained)
