"""The registry of the methods: loading one never trains, and it is run where its row says."""

import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from deepmds_keras import InputError, align, normalise
from deepmds_keras.baselines.map_fit import MapFit, principal_components
from deepmds_keras.geometry.units import rms_radius
from experiments import recipes
from experiments.inputs import load_faces
from experiments.methods import DEEP_MDS, METHODS, load, methods_of, notes, predict
from experiments.presets import TINY
from experiments.run import AUTHORS_FILES, Run


@pytest.fixture
def folder(whole_bfm, tmp_path, monkeypatch):
    """The arrays and weights of the BFM experiment, in the current folder."""
    shutil.copytree(whole_bfm / "build", tmp_path / "build")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_loading_never_trains(folder):
    """The error names the record whose step is to be forced, or the target of `make`."""
    run = Run(preset=TINY, jobs=1)
    files = [path for path in run.work.rglob("*.npz") if path.parent.name != "predictions"]
    before = {path: path.stat().st_mtime_ns for path in files}
    trained = [method.id for method in methods_of(Run()) if method.trained]
    assert len(trained) == 9
    for method in trained:
        load(run, method)
    assert {path: path.stat().st_mtime_ns for path in files} == before
    for networks in (run.networks, run.work / "mobileface"):
        shutil.rmtree(networks)
    for method in trained:
        record = f"{run.work}/records/train-{METHODS[method].trained}.json"
        with pytest.raises(InputError, match=f"does not exist.*--forcerun {record}' trains it"):
            load(run, method)
    assert not run.networks.exists()
    shutil.rmtree(run.work / "records")
    with pytest.raises(InputError, match=r"not trained yet\. make reproduce-bfm trains it"):
        load(run, "mlp")


def test_predictions_take_faces_whichever_way_up(whole_bfm, monkeypatch):
    monkeypatch.chdir(whole_bfm)
    run = Run(preset=TINY, jobs=1)
    turned = load_faces(run, "test").views * (1, -1)
    lifter = load(run, "landmark_lifter")
    with pytest.raises(InputError, match="y must point up"):
        lifter.predict(turned)
    assert np.isfinite(predict(lifter, turned)).all()
    assert np.isfinite(predict(load(run, "mean_shape"), turned)).all()


def test_errors_in_training_are_drawn_for_each_face_where_a_detector_finds_those_of_the_test(
    monkeypatch,
):
    views = normalise(np.random.default_rng(0).normal(size=(2000, 51, 2)))
    monkeypatch.setattr(recipes, "faces", lambda run: (views, views))
    assert recipes.faces_with_noise(Run(preset=TINY))[0] is views
    moved, _ = recipes.faces_with_noise(Run(preset=TINY, track="flame"))
    assert (moved.min((1, 2)) == 0).all() and (moved.max((1, 2)) == 1).all()
    errors = (align(moved, views) - views).std((1, 2)) / rms_radius(views)
    assert errors.mean() == pytest.approx(recipes.LANDMARK_NOISE / 2, rel=0.05)
    assert errors.std() == pytest.approx(recipes.LANDMARK_NOISE / 12**0.5, rel=0.1)


def test_the_fit_of_learnt_components_expects_the_noise_of_a_detector(monkeypatch):
    """Told none, it takes the noise for the face."""
    rng = np.random.default_rng(0)
    mean, basis = rng.normal(size=(51, 3)), 0.02 * rng.normal(size=(60, 51, 3))
    shapes = mean + np.tensordot(rng.normal(size=(600, 60)), basis, 1)
    train, test = shapes[:500], shapes[500:]
    cameras = SimpleNamespace(field_of_view=np.zeros(500))
    faces = SimpleNamespace(shapes=train, cameras=cameras)
    monkeypatch.setattr(recipes, "load_faces", lambda run, part: faces)
    sd = recipes.DETECTOR_SD * rms_radius(test[..., :2])
    views = test[..., :2] + sd[:, None, None] * rng.normal(size=(100, 51, 2))
    untold = MapFit(*principal_components(train, 1e-3)).predict(views)
    told = recipes.LearntMapFit(Run(preset=TINY, track="flame")).predict(views)
    constant = np.broadcast_to(train.mean(0), test.shape)
    error = [((align(found, test) - test) ** 2).mean() for found in (told, untold, constant)]
    assert error[0] < 0.5 * min(error[1:])


def test_methods_that_share_a_network_are_trained_one_after_the_other():
    order = [method.id for method in METHODS.values()]
    for schedule in {schedule for _, schedule in DEEP_MDS.values()}:
        first, *others = (m for m in order if m in DEEP_MDS and DEEP_MDS[m][1] == schedule)
        assert METHODS[first].after is None
        assert all(METHODS[method].after == first for method in others)


def test_a_method_is_run_where_its_row_says(tmp_path):
    ids = {track: [m.id for m in methods_of(Run(track=track))] for track in ("bfm", "flame")}
    assert "aldrian" in ids["bfm"] and "aldrian" not in ids["flame"]
    for name in (*AUTHORS_FILES["bfm"], *recipes.ZHAO_FILES["bfm"]):
        (tmp_path / name).touch()
    given = {m.id for m in methods_of(Run(authors=tmp_path))} - {*ids["bfm"]}
    assert given == {"deep_mds_weights", "zhao_weights"}
    (tmp_path / recipes.MOBILEFACE_FILES["bfm"][0]).touch()
    given = {m.id for m in methods_of(Run("bfm2009", authors=tmp_path))}
    assert "mobileface_weights" in given
    assert all(method.build for method in METHODS.values() if method.tracks)


def test_ringnet_is_left_out_of_flame_whose_expressions_have_no_names():
    runs = {model: Run(model, track="flame") for model in ("ict", "flame")}
    ids = {model: {m.id for m in methods_of(run)} for model, run in runs.items()}
    assert ids["ict"] - ids["flame"] == {"ringnet"}
    assert "no names" in notes(Run(model="flame", track="flame"), {})["ringnet"]
    licensed = methods_of(Run("flame", track="flame", ringnet="prefix"))
    assert "ringnet_licensed" in {method.id for method in licensed}
