"""The CelebA experiment from the command line, at the smallest size."""

import json

import numpy as np
import pandas as pd
import pytest
import runs
from PIL import Image
from places import MEDIAPIPE, SHARED
from runs import run, succeed

from data_gen.datasets.dataset import load_dataset
from deepmds_keras.io.archives import read_arrays

TF_FLAME = SHARED / "tf_flame"
pytestmark = pytest.mark.slow


def results(folder, name="celeba"):
    return runs.results(folder, name)


@pytest.fixture(scope="module")
def whole(whole_celeba):
    return whole_celeba.folder


@pytest.fixture(scope="module")
def work(whole):
    return runs.work(whole, "celeba")


@pytest.fixture
def copy(whole, tmp_path):
    return runs.copy_build(whole, tmp_path)


def mse_of(folder, name):
    table = pd.read_csv(results(folder, name) / "table.csv")
    return table[table["metric"] == "mse"].set_index("method")["mean"]


def test_everything_is_written(whole):
    for name in ("celeba", "celeba-true-landmarks"):
        folder = results(whole, name)
        names = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
        assert {"metrics.csv", "table.csv", "table.tex", "wilcoxon.csv", "manifest.json"} <= names
    figures = {path.stem for path in (results(whole) / "figures").glob("*.png")}
    assert figures == {"summary", "celeba", "fits", "photos", "error_per_landmark"}
    assert (results(whole) / "examples.json").is_file()


def test_tables_have_the_papers_methods_and_both_truths(whole):
    found, true = mse_of(whole, "celeba"), mse_of(whole, "celeba-true-landmarks")
    both = {"zhao", "mobileface", "aldrian", "ours", "mean_shape", "linear", "lifting"}
    assert both | {"true_landmarks"} <= {*found.dropna().index}
    assert both | {"model_fit"} <= {*true.dropna().index}
    # How far the two truths lie apart is the same number from either side, but for the unit.
    assert true["model_fit"] == pytest.approx(found["true_landmarks"], rel=0.3)
    table = pd.read_csv(results(whole) / "table.csv").set_index(["method", "metric"])
    assert table.loc[("mobileface", "mse"), "paper_mean"] == pytest.approx(0.092e-5)


def test_methods_get_what_the_camera_of_the_fit_sees(work):
    test = load_dataset(work / "test.npz")
    photos, _ = read_arrays(work / "photos.npz")
    used = photos["status"] == "used"
    scale = np.ptp(photos["pixels"][used], axis=1) / np.ptp(test.views, axis=1)
    assert np.allclose(scale[:, 0], scale[:, 1], rtol=1e-4)  # one scale, y turned up
    apart = np.linalg.norm(photos["pixels"] - photos["true_pixels"], axis=2)[used].mean()
    assert apart < 8  # of 218 pixels: the fit finds the face


def test_networks_are_those_of_the_bfm_track(whole, work):
    assert not (work / "networks").exists()
    manifest = json.loads((results(whole) / "manifest.json").read_text())
    trained = json.loads((runs.work(whole, "bfm") / "networks.json").read_text())
    record = next(r for r in manifest["stages"] if r["stage"] == "networks")
    assert record["started"] == trained["started"]
    assert manifest["command"].startswith("make reproduce-celeba MODEL=openhead PRESET=tiny")


def test_a_stopped_run_goes_on(work, copy):
    again = runs.work(copy, "celeba")
    (again / "photos.json").unlink()
    (again / "photos.npz").unlink()
    succeed("photos", copy, "--track", "celeba")
    for key, array in read_arrays(work / "photos.npz")[0].items():
        np.testing.assert_array_equal(read_arrays(again / "photos.npz")[0][key], array)
    assert not (again / "predictions").exists()  # of an earlier test set


def write_photos(folder, n):
    """Photos of the stand-in under the names of CelebA's."""
    from data_gen.datasets.photos_standin import PhotosStandin
    from data_gen.models.openhead import load_openhead

    for number, photo in enumerate(PhotosStandin(load_openhead(), n, [3]).photos(range(n)), 1):
        Image.fromarray(photo.image).save(folder / f"{number:06}.jpg")


def test_celeba_as_distributed_takes_the_place_of_the_stand_in(copy, apart):
    """Laid out as CelebA is; one photo is damaged, one shows nobody, one is not for testing."""
    images = copy / "celeba" / "img_align_celeba"
    images.mkdir(parents=True)
    apart(write_photos, images, 11)
    (images / "000012.jpg").write_bytes(b"no photo")
    Image.new("RGB", (178, 218), "grey").save(images / "000013.jpg")
    lines = [f"{number:06}.jpg {0 if number == 5 else 2}" for number in range(1, 14)]
    (copy / "celeba" / "list_eval_partition.txt").write_text("\n".join(lines) + "\n")

    given = ("--track", "celeba", "--celeba", str(copy / "celeba"))
    said = succeed("photos", copy, *given)
    assert "1 unreadable" in said and "no face found" in said
    real = runs.work(copy, "celeba")
    record = json.loads((real.with_name(f"{real.name}-real") / "photos.json").read_text())
    assert record["source"] == "CelebA" and sum(record["photos"].values()) == 12  # not the 5th
    for stage in ("predictions", "celeba"):
        succeed(stage, copy, *given)
    folder = results(copy, "celeba-real")
    assert (folder / "figures" / "celeba.png").is_file()
    table = pd.read_csv(folder / "table.csv")
    assert "true_landmarks" not in {*table["method"]}
    assert not results(copy, "celeba-true-landmarks-real").exists()
    note = table.set_index(["method", "metric"]).loc[("mobileface", "mse"), "note"]
    assert "MOBILEFACE=no" in note


def test_a_folder_that_is_no_celeba_is_refused(tmp_path):
    done = run("photos", tmp_path, "--track", "celeba", "--data", str(tmp_path))
    assert done.returncode == 2 and "img_align_celeba" in done.stderr
    done = run("photos", tmp_path, "--track", "celeba", "--celeba", str(tmp_path / "none"))
    assert done.returncode == 2 and done.stderr.count("\n") == 1


def test_faces_with_flames_landmarks_are_drawn(whole_flame, tmp_path):
    if not TF_FLAME.is_dir():
        pytest.skip("../shared/tf_flame is absent")
    runs.copy_build(whole_flame.folder, tmp_path)
    (runs.work(tmp_path, "flame") / "ringnet.json").unlink()
    succeed("celeba-flame", tmp_path, "--track", "celeba", "--tf-flame", str(TF_FLAME))
    folder = results(tmp_path, "celeba-flame")
    assert (folder / "figures" / "celeba_flame.png").stat().st_size > 50_000
    stages = json.loads((folder / "manifest.json").read_text())["stages"]
    record = next(own for own in stages if own["stage"] == "celeba-flame")
    assert len(record["faces"]) == 4
    expected = ["mediapipe_corrected"] * MEDIAPIPE + ["zhao", "ours", "ours_stable", "lifting"]
    assert record["methods"] == expected


def test_without_them_photos_are_drawn(whole_flame, tmp_path):
    runs.copy_build(whole_flame.folder, tmp_path)
    succeed("celeba-flame-stand-in", tmp_path, "--track", "flame")
    folder = results(tmp_path, "celeba-flame-stand-in")
    assert (folder / "figures" / "celeba_flame.png").stat().st_size > 50_000
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["command"].startswith("make reproduce-flame MODEL=openhead")
    assert manifest["stages"][-1]["methods"][:1] == ["ringnet"]


def test_a_folder_without_such_faces_is_refused(tmp_path):
    done = run("celeba-flame", tmp_path, "--track", "celeba", "--tf-flame", str(tmp_path))
    assert done.returncode == 2 and "_lmks.npy" in done.stderr
