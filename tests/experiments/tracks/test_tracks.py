"""The paper's three experiments at the smallest size: what they write, and from what."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import runs
from PIL import Image
from places import MEDIAPIPE, SHARED

from data_gen.datasets.dataset import load_dataset, save_dataset
from deepmds_keras.errors import InputError
from deepmds_keras.files import read_arrays
from deepmds_keras.landmarks import load_scheme
from experiments.methods import methods_of
from experiments.presets import TINY
from experiments.recipes import ZHAO_FILES
from experiments.records import read_manifest, read_record
from experiments.run import AUTHORS_FILES, SCHEMES, Run

TF_FLAME = SHARED / "tf_flame"
TRACKS = ["bfm", *(pytest.param(track, marks=pytest.mark.slow) for track in ("flame", "celeba"))]
FIGURES = {
    "bfm": {"learning_curves", "qualitative", "qualitative_others", "error_per_pose", "renders"},
    "flame": {"learning_curves", "casia", "casia_others", "error_per_expression", "scans"},
    "celeba": {"celeba", "celeba_others", "fits", "photos"},
}
EVERYWHERE = {
    "mean_shape", "deep_mds_constant", "ridge", "ridge_roll_aligned", "mlp", "zhao", "deep_mds",
    "deep_mds_released", "deep_mds_cosine", "landmark_lifter",
}  # fmt: skip
MEASURED = {
    "bfm": {
        "zhao_authors", "zhao_frontal", "zhao_evaluator", "aldrian", "aldrian_authors", "map",
        "mobileface",
    },
    "flame": {"ringnet", "true_landmarks", "model_fit", "map_learnt", "deep_mds_noise"},
    "celeba": {"aldrian", "aldrian_authors", "map", "mobileface", "true_landmarks"},
}  # fmt: skip


@pytest.fixture
def whole(request):
    """Gives the folder of a track's whole experiment, only to be read."""
    return lambda track: request.getfixturevalue(f"whole_{track}")


@pytest.fixture
def copy(whole, tmp_path):
    """Gives a folder with the arrays and weights of a track's whole experiment."""

    def copy(track):
        shutil.copytree(whole(track) / "build", tmp_path / "build")
        return tmp_path

    return copy


def table_of(folder, name):
    table = pd.read_csv(runs.results(folder, name) / "table.csv")
    return table.set_index(["method", "metric"])


def mse_of(folder, name):
    return table_of(folder, name).xs("mse", level="metric")["mean"].dropna()


def step(name, folder, track, *items, recorded=None, **options):
    """Run a step of a track as Snakemake does, with its record."""
    words = [*items, "--track", track]
    for option, value in options.items():
        words += [f"--{option.replace('_', '-')}", str(value)]
    if recorded:
        words += ["--record", str(runs.work(folder, track) / f"records/{recorded}.json")]
    return runs.run(name, folder, *words)


def ids(track):
    return [m.id for m in methods_of(Run(track=track)) if m.switch != "MEDIAPIPE" or MEDIAPIPE]


@pytest.mark.parametrize("track", TRACKS)
def test_everything_is_written(whole, track):
    truths = [track] if track == "bfm" else [track, f"{track}-true-landmarks"]
    for name in truths:
        folder = runs.results(whole(track), name)
        figures = FIGURES[track] | {"error_per_landmark"} if name == track else set()
        files = {f"figures/{figure}.{kind}" for figure in (*figures, "summary")
                 for kind in ("png", "pdf")}  # fmt: skip
        files |= {"metrics.csv", "table.csv", "table.tex", "table_paper.tex", "wilcoxon.csv"}
        assert {*read_manifest(folder)["files"]} == files
        assert all((folder / file).stat().st_size for file in files)
        over = {*pd.read_csv(folder / "wilcoxon.csv")["over"]}
        assert over == {"subsets", "subjects" if track == "flame" else "faces"}


@pytest.mark.parametrize("track", TRACKS)
def test_a_table_has_every_method_with_a_number_or_a_reason(whole, track):
    rows = table_of(whole(track), track).xs("mse", level="metric")
    measured = EVERYWHERE | MEASURED[track]
    if MEDIAPIPE and track == "flame":
        measured |= {"mediapipe", "mediapipe_corrected"}
    assert {*rows.index[rows["mean"].notna()]} == measured
    assert rows.loc["deep_mds_weights", "note"].startswith("their weight files were not given")
    caution = "smoke: too short to mean anything"
    assert rows.loc["mean_shape", "note"] == caution
    assert (rows.loc["ridge", "note"] == caution) == (track != "flame")
    assert ("with noise" in rows.loc["ridge", "note"]) == (track == "flame")
    assert rows.loc["landmark_lifter", "note"].startswith("not in the paper; trained for 3 steps")
    quoted = {
        "bfm": ("deep_mds", 1.4e-4),
        "flame": ("ringnet", 1.34e-3),
        "celeba": ("mobileface", 9.2e-7),
    }
    method, mean = quoted[track]
    assert rows.loc[method, "paper_mean"] == pytest.approx(mean)
    if track == "bfm":
        assert rows.loc["ridge", "mean"] < rows.loc["mean_shape", "mean"]


@pytest.mark.slow
@pytest.mark.parametrize(("track", "fit"), [("flame", "scan_landmarks"), ("celeba", "model_fit")])
def test_the_second_table_is_against_the_truth(whole, track, fit):
    folder = whole(track)
    paper, true = mse_of(folder, track), mse_of(folder, f"{track}-true-landmarks")
    # How far the two truths lie apart is the same from either side, but for the unit.
    assert true[fit] == pytest.approx(paper["true_landmarks"], rel=0.3)
    assert "true_landmarks" not in true.index
    if track == "flame":  # whose truth favours the fit that it starts from
        assert paper["model_fit"] < true["model_fit"]


@pytest.mark.slow
@pytest.mark.skipif(not MEDIAPIPE, reason="MediaPipe is not installed")
def test_mediapipe_finds_faces_and_the_corrected_list_fits_better(whole_flame):
    table = table_of(whole_flame, "flame")["mean"]
    assert table["mediapipe", "detection_rate"] > 0.9
    assert table["mediapipe_corrected", "mse"] < table["mediapipe", "mse"]


@pytest.mark.slow
def test_the_released_evaluator_scores_the_same_predictions(copy):
    folder = copy("bfm")
    assert step("tracks.bfm", folder, "bfm", *ids("bfm"), evaluator="released").returncode == 0
    assert step("tracks.bfm", folder, "bfm", *ids("bfm")).returncode == 0
    released, paper = (table_of(folder, n) for n in ("bfm-evaluator-released", "bfm"))
    cell = released.loc["zhao_true_depth", "mse"]
    assert 1.8e-3 < cell["mean"] < 2.6e-3 and "rescaled by itself to [0, 1]" in cell["note"]
    # The paper's number stands next to the views that the authors gave to the net.
    assert released.loc[("zhao_frontal", "mse"), "paper_mean"] == 22e-4
    assert paper.loc[("zhao_evaluator", "mse"), "paper_mean"] == 22e-4
    others = ["mean_shape", "ridge", "aldrian", "mobileface", "deep_mds"]
    pd.testing.assert_frame_equal(released.loc[others], paper.loc[others], check_exact=True)


def test_a_preview_is_the_table_without_what_takes_long(copy):
    folder = copy("bfm")
    few = ["mean_shape", "ridge", "deep_mds"]
    done = step("tracks.preview", folder, "bfm", *few, seeds=2)  # of which one is not trained yet
    assert done.returncode == 0, done.stderr
    row = next(line for line in done.stdout.splitlines() if line.startswith("Deep-MDS "))
    assert "71.95 ± 0.002" in row and "left out (MOBILEFACE=no)" in done.stdout
    assert not (folder / "results").exists()


# What steps read, and what they make of stale or damaged files.


def test_images_that_were_changed_are_named(copy):
    folder = copy("bfm")
    path = runs.work(folder, "bfm") / "images/test/0000.npy"
    content = bytearray(path.read_bytes())
    content[5000] ^= 1
    path.write_bytes(content)
    done = step("tracks.predict", folder, "bfm", "mobileface")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "was changed since" in done.stderr and path.name in done.stderr


def test_checkpoints_of_other_faces_are_not_gone_on_from(copy):
    folder = copy("bfm")
    work = runs.work(folder, "bfm")
    kept = read_arrays(work / "networks/zhao.npz")[1]["history"]
    assert step("tracks.train", folder, "bfm", "zhao").returncode == 0
    assert read_arrays(work / "networks/zhao.npz")[1]["history"] == kept
    train = load_dataset(work / "train.npz")
    save_dataset(work / "train.npz", replace(train, views=1.1 * train.views))
    done = step("tracks.train", folder, "bfm", "zhao")
    assert done.returncode == 0, done.stderr
    assert read_arrays(work / "networks/zhao.npz")[1]["history"] != kept
    assert not (work / "networks/lifting.npz").exists()
    assert (work / "mobileface/cosine.npz").exists()  # of images, which are as they were


def test_every_image_shows_its_face_whichever_process_draws_it(copy):
    folder = copy("bfm")
    images = runs.work(folder, "bfm") / "images/test"
    drawn = np.load(images / "0000.npy")
    (images / "0000.npy").unlink()  # as of a step that was killed
    assert step("datasets.images", folder, "bfm").returncode == 0
    assert np.array_equal(np.load(images / "0000.npy"), drawn)
    assert drawn.std((1, 2, 3)).min() > 10


@pytest.mark.slow
def test_views_are_centred_in_training_and_in_test_but_not_by_the_released_protocol(
    whole_flame, tmp_path
):
    """Min-max scaling of both axes together sees where the origin is."""
    work = runs.work(whole_flame, "flame")
    for part in ("train", "test"):
        assert np.abs(load_dataset(work / f"{part}.npz").views.mean(1)).max() < 1e-3
    assert step("datasets.frames", tmp_path, "flame", protocol="released").returncode == 0
    released = replace(Run(), track="flame", preset=TINY, protocol="released").work
    views = load_dataset(tmp_path / released / "train.npz").views
    assert np.abs(views.mean(1)).max() > 5  # mm


# Faces found in scans and photos.


@pytest.mark.slow
def test_scans_give_detected_views_and_landmarks_found(whole_flame):
    work = runs.work(whole_flame, "flame")
    test, (scans, _) = load_dataset(work / "test.npz"), read_arrays(work / "scans.npz")
    counted = json.loads((work / "records/scans.json").read_text())["scans"]
    assert sum(counted.values()) == TINY.scans == len({*scans["name"]})
    assert counted["used"] == len(test) == (scans["status"] == "used").sum()
    assert {*scans["condition"]} >= {"neutral", "smile", "surprise"}
    seen = scans["detected"] * (1, -1)
    assert np.allclose(test.views, seen - seen.mean(1, keepdims=True), atol=1e-3)
    assert np.array_equal(test.landmarks, np.float32(scans["landmarks"]))
    # The registration errs, by some millimetres.
    assert 0.5 < np.linalg.norm(scans["landmarks"] - scans["truth"], axis=2).mean() < 8
    assert np.abs(test.cameras.yaw).max() < 40


@pytest.mark.slow
def test_methods_get_what_the_camera_of_the_fit_sees(whole_celeba):
    work = runs.work(whole_celeba, "celeba")
    test, (photos, _) = load_dataset(work / "test.npz"), read_arrays(work / "photos.npz")
    scale = np.ptp(photos["pixels"], axis=1) / np.ptp(test.views, axis=1)
    assert np.allclose(scale[:, 0], scale[:, 1], rtol=1e-4)  # one scale, y turned up
    assert not (work / "networks").exists()  # those of the BFM track are tested


@pytest.mark.slow
@pytest.mark.parametrize(("track", "kind"), [("flame", "scan"), ("celeba", "photo")])
def test_a_stopped_search_goes_on_and_finds_the_same(copy, track, kind):
    """A piece that is done is taken from its file, unless it is of other faces."""
    folder = copy(track)
    work = runs.work(folder, track)
    table = read_arrays(work / f"{kind}s.npz")[0]
    views = load_dataset(work / "test.npz").views
    for path in (work / "test.npz", work / f"{kind}s.npz"):
        path.unlink()
    pieces = work / f"{kind}s"
    pieces.mkdir()
    (pieces / "0000.npz").write_bytes(b"of another model")
    done = step(f"datasets.{kind}s", folder, track)
    assert done.returncode == 0, done.stderr
    assert not pieces.exists()
    for key, array in read_arrays(work / f"{kind}s.npz")[0].items():
        np.testing.assert_array_equal(array, table[key])
    assert np.array_equal(load_dataset(work / "test.npz").views, views)


def write_photos(folder, n):
    """Photos of the substitute under the names of CelebA's."""
    from data_gen.datasets.photos_substitute import PhotosSubstitute
    from data_gen.models.openhead import load_openhead

    for number, photo in enumerate(PhotosSubstitute(load_openhead(), n, [3]).photos(range(n)), 1):
        Image.fromarray(photo.image).save(folder / f"{number:06}.jpg")


@pytest.mark.slow
def test_celeba_as_distributed_takes_the_place_of_the_stand_in(copy, apart):
    """Laid out as CelebA is; one photo is damaged, one shows nobody, one is not for testing."""
    folder = copy("bfm")
    images = folder / "celeba" / "img_align_celeba"
    images.mkdir(parents=True)
    apart(write_photos, images, 11)
    (images / "000012.jpg").write_bytes(b"no photo")
    Image.new("RGB", (178, 218), "grey").save(images / "000013.jpg")
    lines = [f"{number:06}.jpg {0 if number == 5 else 2}" for number in range(1, 14)]
    (folder / "celeba" / "list_eval_partition.txt").write_text("\n".join(lines) + "\n")

    runs.make("reproduce-celeba", folder, f"CELEBA={folder / 'celeba'}", "MOBILEFACE=no",
              "TF_FLAME=", "RINGNET=no")  # fmt: skip
    work = runs.work(folder, "celeba")
    record = json.loads((work.with_name(f"{work.name}-real") / "records/photos.json").read_text())
    assert record["source"] == "CelebA" and sum(record["photos"].values()) == 12  # not the 5th
    assert {"unreadable", "no face found"} < {*record["photos"]}
    assert (runs.results(folder, "celeba-real") / "figures/celeba.png").is_file()
    table = table_of(folder, "celeba-real")
    assert "true_landmarks" not in table.index
    assert not runs.results(folder, "celeba-true-landmarks-real").exists()
    assert "MOBILEFACE=no" in table.loc[("mobileface", "mse"), "note"]


def test_each_photo_with_landmarks_is_shown_and_must_be_there(tmp_path):
    from experiments.tracks.celeba_flame import read_folder

    (tmp_path / "._a_lmks.npy").write_bytes(b"of macOS")
    np.save(tmp_path / "a_lmks.npy", np.ones((51, 2)))
    with pytest.raises(InputError, match=r"a_lmks.npy must .* photo .* Received no a\.jpeg"):
        read_folder(tmp_path)
    (tmp_path / "a.jpeg").touch()
    assert read_folder(tmp_path)[0] == [tmp_path / "a.jpeg"]


# Methods that are given, or see other photos.


@pytest.mark.slow
@pytest.mark.parametrize("track", ["bfm", "flame"])
def test_the_authors_weights_have_a_row(copy, track, tmp_path):
    # Here, since the process that draws photos imports this module, and may not load TensorFlow.
    from writers.keras2 import write_keras2

    from deepmds_keras import build_autoencoder, build_dissimilarity_net
    from deepmds_keras.baselines.zhao import build_zhao_net

    weights = tmp_path / "weights"
    weights.mkdir()
    n = len(load_scheme(SCHEMES[track]))
    nets = build_autoencoder(n, seed=3), build_dissimilarity_net("released", seed=3)
    for name, network in zip(AUTHORS_FILES[track], nets, strict=True):
        write_keras2(weights / name, network)
    write_keras2(weights / ZHAO_FILES[track][0], build_zhao_net(n, seed=3))
    folder = copy(track)
    (runs.work(folder, track) / "landmark_model.npz").unlink()  # which only RingNet needs
    for method in ("deep_mds_weights", "zhao_weights"):
        done = step("tracks.predict", folder, track, method, authors=weights)
        assert done.returncode == 0, done.stderr
    few = ["mean_shape", "deep_mds", "ridge", "zhao", "deep_mds_weights"]
    done = step("tracks.preview", folder, track, *few, authors=weights)
    assert done.returncode == 0 and "Deep-MDS, authors' weights" in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("given", [True, False])
def test_faces_with_flames_landmarks_are_drawn(copy, given):
    """Of the folder TF_FLAME, or drawn in their place."""
    if given and not TF_FLAME.is_dir():
        pytest.skip("../shared/tf_flame is absent")
    of_views = ["zhao", "deep_mds", "landmark_lifter"]
    of_photos = ["ringnet", *["mediapipe_corrected"] * MEDIAPIPE]
    folder, options = copy("flame"), {"tf_flame": TF_FLAME} if given else {}
    methods, recorded = [*of_views, *of_photos], "celeba-flame"
    done = step("tracks.celeba_flame", folder, "flame", *methods, recorded=recorded, **options)
    assert done.returncode == 0, done.stderr
    results = runs.results(folder, "celeba-flame" if given else "celeba-flame-substitute")
    assert (results / "figures/celeba_flame.png").stat().st_size > 50_000
    record = read_record(runs.work(folder, "flame") / f"records/{recorded}.json")
    assert record["methods"] == of_photos + of_views
    assert not given or len(record["faces"]) == 4
