"""The BFM experiment from the command line: runs, stops, goes on, refuses what it cannot use."""

import fcntl
import json
import shutil

import pandas as pd
import pytest
import runs
from places import SHARED
from runs import run

RELEASED = SHARED / "released" / "bfm"


def results(folder):
    return runs.results(folder, "bfm")


@pytest.fixture(scope="module")
def whole(whole_bfm, tmp_path_factory):
    """A copy of the run that nothing disturbed, to go on from."""
    folder = tmp_path_factory.mktemp("stages") / "whole"
    return shutil.copytree(whole_bfm.folder, folder)


def test_everything_is_written(whole):
    names = {str(p.relative_to(results(whole))) for p in results(whole).rglob("*") if p.is_file()}
    assert {"metrics.csv", "table.csv", "table.tex", "wilcoxon.csv", "manifest.json"} <= names
    figures = {"summary", "learning_curves", "qualitative", "error_per_landmark", "error_per_pose",
               "renders"}  # fmt: skip
    assert {f"figures/{name}.{kind}" for name in figures for kind in ("png", "pdf")} <= names
    assert (results(whole).parent / "parameters" / "table.csv").is_file()


def test_manifest_says_what_made_the_results(whole):
    manifest = json.loads((results(whole) / "manifest.json").read_text())
    assert (
        manifest["command"] == "make reproduce-bfm MODEL=openhead PRESET=tiny SEED=0 PROTOCOL=paper"
    )
    stages = [record["stage"] for record in manifest["stages"]]
    assert stages == ["faces", "networks", "predictions", "images", "mobileface"]
    assert {"numpy", "keras", "scikit-learn"} <= manifest["packages"].keys()
    assert len(manifest["model_sha256"]) == 64
    seconds = manifest["stages"][1]["training_seconds"]
    trained = ["ours", "ours_released", "zhao", "zhao_authors", "ours_stable", "lifting"]
    assert [*seconds] == trained
    assert min(seconds.values()) >= 0 < seconds["lifting"]


def test_lifting_has_fewer_parameters_than_deep_mds(whole):
    table = pd.read_csv(results(whole).parent / "parameters" / "table.csv").set_index("method")
    own = table.loc["lifting"]
    assert own["trainable"] == own["total"] == 25_747 < table.loc["ours", "trainable"]


def test_table_has_every_method_with_a_number_or_a_reason(whole):
    table = pd.read_csv(results(whole) / "table.csv").set_index(["method", "metric"])
    mse = table.xs("mse", level="metric")
    measured = ["mean_shape", "linear", "zhao", "zhao_authors", "zhao_frontal", "aldrian",
                "aldrian_authors", "mobileface", "ours", "ours_released", "ours_stable",
                "lifting"]  # fmt: skip
    assert [*mse.index[mse["mean"].notna()]] == measured
    assert mse.loc["authors_weights", "note"].startswith("their weight files were not given")
    assert "2 steps of 16 images" in mse.loc["mobileface", "note"]
    caution = "smoke: too short to mean anything"
    note = f"not in the paper; trained for 3 steps of 128 faces; {caution}"
    assert mse.loc["lifting", "note"] == note
    assert mse.loc["linear", "note"] == caution
    assert mse.loc["lifting", "mean"] < mse.loc["mean_shape", "mean"]
    assert mse.loc["ours", "paper_mean"] == 1.4e-4
    assert mse.loc["linear", "mean"] < mse.loc["mean_shape", "mean"]


@pytest.mark.slow
def test_without_mobileface_the_rest_is_the_same(whole, tmp_path):
    folder = runs.copy_build(whole, tmp_path)
    for name in ("bfm.json", "mobileface.json", "predictions/mobileface.npz"):
        (runs.work(folder, "bfm") / name).unlink()
    runs.succeed("bfm", folder, "--without", "MOBILEFACE")
    without, table = (
        pd.read_csv(results(own) / "table.csv").set_index(["method", "metric"])
        for own in (folder, whole)
    )
    assert without.loc["mobileface", "mean"].isna().all()
    assert (
        without.loc[("mobileface", "mse"), "note"] == "left out (MOBILEFACE=no), or still to come"
    )
    rest = without.drop("mobileface", level="method")
    pd.testing.assert_frame_equal(rest, table.loc[rest.index], check_exact=True)


@pytest.mark.slow
def test_the_released_evaluator_scores_the_same_predictions(whole):
    done = run("bfm", whole, "--evaluator", "released")
    assert done.returncode == 0, done.stderr
    folder = results(whole).with_name("bfm-evaluator-released")
    released, paper = (
        pd.read_csv(path / "table.csv").set_index(["method", "metric"])
        for path in (folder, results(whole))
    )
    cell = released.loc[("zhao_true_depth", "mse")]
    assert 1.8e-3 < cell["mean"] < 2.6e-3
    assert "rescaled by itself to [0, 1]" in cell["note"]
    # The paper's number stands beside the views that the authors gave to the net.
    assert released.loc[("zhao_frontal", "mse"), "paper_mean"] == 22e-4
    assert paper.loc[("zhao", "mse"), "paper_mean"] == 22e-4
    others = ["mean_shape", "linear", "aldrian", "mobileface", "ours"]
    pd.testing.assert_frame_equal(released.loc[others], paper.loc[others], check_exact=True)
    shown = run("show", whole, "--evaluator", "released")
    assert "True depth in place of Zhao et al." in shown.stdout


def test_show_prints_the_papers_number_beside_ours(whole):
    shown = run("show", whole)
    assert shown.returncode == 0
    line = next(row for row in shown.stdout.splitlines() if row.startswith("Deep-MDS "))
    assert "71.95 ± 0.002" in line
    assert "1.4 ± 0.005" in line


def test_two_runs_do_not_share_a_folder(whole):
    lock = next((whole / "build").rglob(".lock"))
    with open(lock, "w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        refused = run("bfm", whole)
    assert refused.returncode == 2
    assert "is in use by another run" in refused.stderr


def test_a_damaged_cache_is_reported(whole, tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(whole, folder)
    path = next((folder / "build").rglob("predictions/linear.npz"))
    path.write_bytes(path.read_bytes()[:200])
    refused = run("bfm", folder)
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert "linear.npz must be an npz" in refused.stderr


def test_a_changed_image_is_reported(whole, tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(whole / "build", folder / "build")
    path = next((folder / "build").rglob("images/test/0000.npy"))
    content = bytearray(path.read_bytes())
    content[5000] ^= 1
    path.write_bytes(content)
    refused = run("mobileface", folder)
    assert refused.returncode == 2
    assert "0000.npy was changed since it was made" in refused.stderr.splitlines()[-1]
    assert "Traceback" not in refused.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--model", "bfm2009"], "DATA= must be the file or folder of bfm2009"),
        (["--model", "ict", "--data", "/nowhere"], "/nowhere"),
        (["--model", "bfm2017", "--data", __file__], "test_stages.py"),
        (["--model", "nobody"], "invalid choice: 'nobody'"),
        (["--seed", "-1"], "--seed must not be negative"),
        (["--evaluator", "mine"], "invalid choice: 'mine'"),
        (["--authors", "/nowhere"], "--authors must be a folder with AE_occ2orth_BFM.h5"),
    ],
)
def test_unusable_arguments_end_with_one_line_and_status_2(tmp_path, arguments, message):
    refused = run("faces", tmp_path, *arguments)
    assert refused.returncode == 2
    assert message in refused.stderr.splitlines()[-1]
    assert "Traceback" not in refused.stderr
    assert not [*tmp_path.rglob("*.npz")]


@pytest.mark.slow
@pytest.mark.skipif(not RELEASED.is_dir(), reason="the authors' weights (../shared) are absent")
def test_the_authors_weights_join_a_run_that_is_done(whole):
    done = run("predictions", whole, "--authors", str(RELEASED))
    assert done.returncode == 0, done.stderr
    assert run("bfm", whole, "--authors", str(RELEASED)).returncode == 0
    table = pd.read_csv(results(whole) / "table.csv").set_index(["method", "metric"])
    assert 0 < table.loc[("authors_weights", "mse"), "mean"] < 1e-3
