"""What the shipped weights are trained on and measured with, and the steps at the smallest size."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import runs
from places import MEDIAPIPE

from data_gen.models.registry import load_model
from data_gen.views import sample_photo_views
from deepmds_keras.geometry.alignment import align
from deepmds_keras.geometry.units import normalise, rms_radius
from deepmds_keras.tool.detection import move, upright_axes
from experiments.presets import TINY
from experiments.pretrained.pretrained import errors_of
from experiments.pretrained.real_faces import differences, reliability
from experiments.pretrained.train import sample_faces


def test_an_error_is_in_radii_and_that_of_another_place_does_not_count():
    rng = np.random.default_rng(0)
    view, error = rng.normal(0, 80, (3, 68, 2)), rng.normal(0, 4, (3, 68, 2))
    error[1] += 80
    error[2] = np.nan
    photos = {"pixels_ibug68": view + 100, "dlib": view + 100 + error}
    errors, detected = errors_of(photos, "dlib")
    assert detected.tolist() == [True, False, False], "another place, and no face"
    radius = rms_radius(view[:, 17:])[:, None, None]
    np.testing.assert_allclose(errors[0], (error / radius)[0])


def test_faces_differ_more_than_those_of_the_models_which_take_equal_parts():
    model = load_model("openhead", None, "ibug51")
    model = model.restrict(model.landmarks["ibug51"])
    larger = type(model)(**{**vars(model), "mean": 2 * model.mean})
    views, shapes, sd = sample_faces([model, larger], 2000, np.random.default_rng(0))
    assert views.shape == (2000, 51, 2) and shapes.shape == (2000, 51, 3)
    sizes = np.ptp(shapes, axis=1).max(1)
    large = sizes > 1.4 * np.quantile(sizes, 0.25)
    assert 0.45 < large.mean() < 0.55 and 0.4 < large[:300].mean() < 0.6, "in random order"
    centred = normalise(shapes).reshape(len(sizes), -1)
    values = np.linalg.svd(centred - centred.mean(0), compute_uv=False) / len(sizes) ** 0.5
    assert values[120] > 1e-4, "no few components span them"
    assert sd.shape == (2000,) and 150 < (sd == 0).sum() < 250 and np.median(sd) < 3


def test_faces_of_the_open_head_go_towards_the_other_model():
    model = load_model("openhead", None, "ibug51")
    model = model.restrict(model.landmarks["ibug51"])
    nose = np.zeros((51, 3))
    nose[12:14, 2] = 10
    other = replace(model, name="ict", mean=model.mean + nose)
    shapes = sample_faces([model, other], 4000, np.random.default_rng(0))[1]
    alone = sample_faces([model], 4000, np.random.default_rng(0))[1]
    longer = (align(shapes.mean(0), alone.mean(0)) - alone.mean(0))[12:14, 2].mean()
    assert 9 < longer < 13, "of the difference between the means: 1.125 on the average"


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
    rows = {row["method"]: row for row in reliability(Methods(), faces)}
    lifter, noise = rows["landmark_lifter"], rows["noise"]
    assert lifter["ratio"] < 0.2 and 0 < lifter["within"] < lifter["between"]
    assert lifter["low"] < lifter["ratio"] < lifter["high"] < noise["low"] < 1 < noise["high"]
    assert lifter["less"] == lifter["less_high"] == 0 < noise["less_low"] < noise["less_high"]
    assert np.isnan(rows["constant"]["ratio"]), "which tells nothing of a face"


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
