"""What the shipped weights are trained on and measured with, and the steps at the smallest size."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import runs
from places import MEDIAPIPE, SHARED

from data_gen.models.registry import load_model
from data_gen.views import sample_photo_views
from deepmds_keras.files import write_arrays
from deepmds_keras.geometry.alignment import align
from deepmds_keras.geometry.camera import HeadPose
from deepmds_keras.geometry.units import normalise, rms_radius
from deepmds_keras.landmarks import convert, load_scheme
from deepmds_keras.tool.detection import detector_sd, move, upright_axes
from experiments.presets import TINY
from experiments.pretrained import pretrained
from experiments.pretrained.canonical_face import (
    CANONICAL,
    canonical_mean,
    read_canonical_face,
    write_canonical_face,
)
from experiments.pretrained.portraits import portraits_file, read_portraits
from experiments.pretrained.pretrained import Views, _on_detections, detections, errors_of
from experiments.pretrained.real_faces import differences, different_photos, reliability
from experiments.pretrained.residuals import mean_residuals, misfits, of_detectors
from experiments.pretrained.train import sample_faces
from experiments.run import Run

CANONICAL_OBJ = SHARED / "mediapipe" / "canonical_face_model.obj"


def test_an_error_is_in_radii_and_that_of_another_place_does_not_count(monkeypatch):
    rng = np.random.default_rng(0)
    view, error = rng.normal(0, 80, (3, 68, 2)), rng.normal(0, 4, (3, 68, 2))
    error[1] += 80
    error[2] = np.nan
    photos = {"pixels_ibug68": view + 100, "dlib": view + 100 + error}
    errors, detected = errors_of(photos, "dlib")
    assert detected.tolist() == [True, False, False], "another place, and no face"
    radius = rms_radius(view[:, 17:])[:, None, None]
    np.testing.assert_allclose(errors[0], (error / radius)[0])
    photos["yaw"] = np.array([-53, 2, 9])
    monkeypatch.setattr(pretrained, "read_portraits", lambda run, model: photos)
    table = detections(Run()).set_index("yaw")
    found = table[["n_photos", "found"]].to_numpy().tolist()
    assert (found, [*table.index]) == ([[1, 1], [2, 0]], [-60, 0])
    assert table.loc[-60, "rms"] == pytest.approx(100 * np.sqrt((errors[0, 17:] ** 2).mean()))


def test_no_face_is_in_the_regression_that_predicts_it():
    rng = np.random.default_rng(0)
    views, truth = rng.normal(size=(40, 51, 2)), rng.random((40, 51, 3))
    shapes, others = (
        _on_detections({"openhead": Views(views, views, moved, np.ones(40, bool))})["openhead"]
        for moved in (truth, truth + (np.arange(40) % 2 == 0)[:, None, None])
    )
    np.testing.assert_array_equal(shapes[::2], others[::2])
    assert (shapes[1::2] != others[1::2]).all()


@pytest.fixture(scope="module")
def openhead():
    model = load_model("openhead", None, "ibug51")
    return model.at_landmarks("ibug51")


def test_faces_differ_more_than_those_of_the_models_a_third_of_which_are_of_the_open_head(openhead):
    larger = replace(openhead, name="ict", mean=2 * openhead.mean)
    rng = np.random.default_rng(0)
    views, shapes, sd = sample_faces([openhead, larger], "ibug51", 2000, rng)
    assert views.shape == (2000, 51, 2) and shapes.shape == (2000, 51, 3)
    sizes = np.ptp(shapes, axis=1).max(1)
    large = sizes > 1.4 * np.quantile(sizes, 0.15)
    assert 0.63 < large.mean() < 0.7 and 0.58 < large[:300].mean() < 0.75, "in random order"
    centred = normalise(shapes).reshape(len(sizes), -1)
    values = np.linalg.svd(centred - centred.mean(0), compute_uv=False) / len(sizes) ** 0.5
    assert values[120] > 1e-4, "no few components span them"
    assert sd.shape == (2000,) and 150 < (sd == 0).sum() < 250 and np.median(sd) < 3


def test_the_mean_of_the_training_faces_is_a_mix_of_three_means(openhead):
    """The depth of iBUG's landmark 30, above the tip of the nose, tells them apart."""
    other = replace(openhead, name="ict")
    shapes = sample_faces([openhead, other], "ibug51", 4000, np.random.default_rng(0))[1]
    means = (openhead.mean, shapes.mean(0), canonical_mean(openhead.mean, "ibug51"))
    depths = [nose_depth(face) for face in means]
    mixed = 0.6 * depths[0] + 0.4 * depths[2]
    assert depths == pytest.approx([0.139, mixed, 0.274], abs=0.005)
    of_faces = np.array([nose_depth(face) for face in shapes])
    assert np.quantile(of_faces, 0.02) < depths[0] and np.quantile(of_faces, 0.98) > depths[2]


def nose_depth(face):
    eyes = np.linalg.norm(face[19] - face[28])
    return float((face[12, 2] - face[:, 2].mean()) / eyes)


@pytest.mark.parametrize("scheme", ["ibug51", "ibug68", "bfm72"])
def test_landmarks_that_the_canonical_face_lacks_move_like_their_neighbours(scheme):
    model = load_model("openhead", None, scheme)
    mean = model.mean[model.landmarks[scheme]]
    moved = canonical_mean(mean, scheme) - mean
    nose = np.array(load_scheme(scheme).groups) == "nose"
    assert 3 < moved[nose, 2].max() < 15, "mm: a deeper nose"
    assert np.linalg.norm(moved, axis=1).max() < 15
    if scheme == "ibug68":
        inner = convert(mean + moved, scheme, "ibug51")
        face = align(read_canonical_face(), inner, reflection=False)
        np.testing.assert_allclose(inner, face, atol=0.01)


@pytest.mark.skipif(not CANONICAL_OBJ.exists(), reason="../shared/mediapipe is absent")
def test_the_table_of_the_canonical_face_is_what_the_script_makes(tmp_path):
    write_canonical_face(CANONICAL_OBJ, tmp_path / "face.csv")
    assert (tmp_path / "face.csv").read_text() == CANONICAL.read_text()


def real_faces(offset, noise):
    """51 landmarks of random faces in images by two detectors, and the offset between the two."""
    rng = np.random.default_rng(0)
    model = load_model("openhead", None, "ibug51")
    views = sample_photo_views(model, "ibug51", 60, rng, detector_sd=0)[0] * (1, -1) + 500
    axes, radius = upright_axes(views, "ibug51")
    moved = views - radius[:, None, None] * (offset @ axes)
    errors = noise * radius[:, None, None] * rng.standard_normal(views.shape)
    return {"dlib": views, "mediapipe": moved + errors}


def test_the_offset_between_detectors_is_found_and_taken_back():
    offset = np.random.default_rng(1).normal(0, 0.05, (51, 2))
    faces = real_faces(offset, 0)
    apart = differences(faces)
    np.testing.assert_allclose(apart.mean(0), offset, atol=0.01)
    back = move(faces["mediapipe"], "ibug51", apart.mean(0)) - faces["dlib"]
    assert np.abs(back).max() < 1.5, "pixels, of faces of 90"


def test_a_landmark_that_a_detector_puts_elsewhere_on_every_face_stands_in_the_table():
    faces = real_faces(np.zeros((51, 2)), 0.02)
    true, nose = faces["dlib"].copy(), load_scheme("ibug51").index("nose_tip")
    axes, radius = upright_axes(true, "ibug51")
    faces["dlib"][:, nose] += 0.1 * radius[:, None] * axes[:, 1]

    class Lifter:
        """It knows the faces, and sees them straight from the front."""

        def estimate(self, views, landmark_sd):
            n = len(views)
            flat = np.concatenate([true * (1, -1), np.zeros((n, 51, 1))], axis=2)
            turned = np.stack([np.eye(3)] * n)
            return flat, None, HeadPose(turned, np.ones(n), np.zeros((n, 2)), np.zeros(n))

    found = of_detectors(Lifter(), faces)
    table = mean_residuals(found)
    assert len(table) == 2 * 51
    tip = table[table["differs"]].squeeze()
    assert (tip["detector"], tip["name"], tip["landmark"]) == ("dlib", "nose_tip", 31)
    assert 0.08 < tip["down"] < 0.11 and abs(tip["right"]) < 1e-3 and tip["error"] < 0.01
    dlib, _, mediapipe, _ = misfits(found)
    assert dlib["less_mean"] < 0.3 * dlib["misfit"], "it is the same on every face"
    assert 0.95 < mediapipe["less_mean"] / mediapipe["misfit"] < 1.1, "its errors are not"


def test_shapes_that_agree_between_detectors_and_differ_between_people_are_reliable():
    rng, constant = np.random.default_rng(0), np.random.default_rng(1).normal(size=(51, 3))

    class Methods:
        def predict(self, views, sd):
            depth = views.std((1, 2), keepdims=True) + 0 * views[..., :1]
            return {
                "landmark_lifter": np.concatenate([views, depth], 2),
                "noise": rng.normal(size=(len(views), 51, 3)),
                "constant": np.stack([constant] * len(views)),
            }

    faces = real_faces(np.zeros((51, 2)), 0.01)
    rows = {row["method"]: row for row in reliability(Methods(), faces, np.zeros((60, 51, 2)))}
    lifter, noise = rows["landmark_lifter"], rows["noise"]
    assert lifter["ratio"] < 0.2 and 0 < lifter["within"] < lifter["between"]
    assert lifter["low"] < lifter["ratio"] < lifter["high"] < noise["low"] < 1 < noise["high"]
    assert lifter["less"] == lifter["less_high"] == 0 < noise["less_low"] < noise["less_high"]
    assert np.isnan(rows["constant"]["ratio"]), "which tells nothing of a face"


@pytest.mark.parametrize("strength", [6.0, 1.0])
def test_methods_are_told_errors_of_the_assumed_strength(strength):
    """As shipped at 6; at 1 those that explain the detectors' differences."""
    told = []

    class Methods:
        def predict(self, views, sd):
            told.append(sd / rms_radius(views)[:, None])
            return {"landmark_lifter": np.dstack([views, views[..., 0]])}

    faces = real_faces(np.zeros((51, 2)), 0.01)
    reliability(Methods(), faces, np.zeros((60, 51, 2)), strength=strength)
    shipped = detector_sd("dlib", "ibug51")
    assert np.mean(told[0] / shipped) ** 2 == pytest.approx(strength / 6, rel=0.1)


def test_a_photo_in_two_sizes_counts_once():
    faces = real_faces(np.zeros((51, 2)), 0.04)
    rng, larger = np.random.default_rng(2), {}
    for detector, of in faces.items():
        twice = np.concatenate([of, 1.5 * of[[7]] - 40 + rng.normal(0, 1, (1, 51, 2))])
        larger[detector] = twice[[*range(60), 60, 3]]
    assert different_photos(larger).tolist() == [*range(60)], "the copies are last"
    larger["mediapipe"][-1] = faces["mediapipe"][4]
    assert different_photos(larger).tolist() == [*range(60), 61], "for one detector alone it is not"


def test_the_sd_of_detectors_are_of_other_photos_than_those_of_the_tests(tmp_path):
    run = Run(preset=TINY, build=tmp_path)
    n = TINY.test_portraits + TINY.further_portraits
    portraits_file(run, "ict").parent.mkdir(parents=True)
    write_arrays(portraits_file(run, "ict"), {"yaw": np.arange(n)}, {})
    tested, further = (read_portraits(run, "ict", each)["yaw"] for each in (False, True))
    assert len(tested) == TINY.test_portraits and [*tested, *further] == [*range(n)]


@pytest.mark.slow
def test_every_scheme_is_measured_on_exact_landmarks_and_on_those_found(tmp_path):
    runs.make("pretrained", tmp_path)
    folder = runs.results(tmp_path, "pretrained")
    table, detection = (pd.read_csv(folder / f"{name}.csv") for name in ("table", "detection"))
    exact = table[table["views"] == "exact"]
    assert {*exact["scheme"]} == {"ibug51", "ibug68", "bfm72"}
    assert (exact["n_faces"] == TINY.test_portraits).all() and not exact["not_found"].any()
    mean = table[table["method"] == "mean_shape"]["found_again"]
    assert (mean.abs() < 1e-9).all(), "the mean shape recovers nothing of a face"
    n_photos = detection.groupby("detector")["n_photos"].sum()
    n_detectors = 1 + MEDIAPIPE
    assert n_photos.to_dict() == dict.fromkeys(["dlib", "mediapipe"][:n_detectors], 6)


def test_half_a_table_of_heads_is_not_written(tmp_path):
    done = runs.run("pretrained.surface", tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "DATA must be a folder with ict" in done.stderr and not [*tmp_path.iterdir()]
