"""What the shipped weights are trained on and measured with, and the steps at the smallest size."""

import numpy as np
import pandas as pd
import pytest
import runs
from places import MEDIAPIPE

from data_gen.models.registry import load_model
from deepmds_keras.alignment import normalise, rms_radius
from experiments.presets import TINY
from experiments.pretrained.pretrained import errors_of
from experiments.pretrained.train import sample_faces


def test_an_error_is_in_radii_and_that_of_another_place_does_not_count():
    rng = np.random.default_rng(0)
    view, error = rng.normal(0, 80, (3, 68, 2)), rng.normal(0, 4, (3, 68, 2))
    error[1] += 80
    error[2] = np.nan
    photos = {"pixels_ibug68": view + 100, "dlib": view + 100 + error}
    errors, found = errors_of(photos, "dlib")
    assert found.tolist() == [True, False, False], "another place, and no face"
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
    assert sd.shape == (2000,) and sd.min() >= 0 and 5 < sd.max() <= 6 and np.median(sd) < 2


@pytest.mark.slow
def test_every_scheme_is_measured_on_exact_landmarks_and_on_those_found(tmp_path):
    runs.make("pretrained", tmp_path)
    folder = runs.results(tmp_path, "pretrained")
    table, found = (pd.read_csv(folder / f"{name}.csv") for name in ("table", "detection"))
    exact = table[table["views"] == "exact"]
    assert {*exact["scheme"]} == {"ibug51", "ibug68", "bfm72"}
    assert (exact["n_faces"] == TINY.test_portraits).all() and not exact["not_found"].any()
    mean = table[table["method"] == "mean_shape"]["found_again"]
    assert (mean.abs() < 1e-9).all(), "the mean shape recovers nothing of a face"
    n_photos = found.groupby("detector")["n_photos"].sum()
    n_detectors = 1 + MEDIAPIPE
    assert n_photos.to_dict() == dict.fromkeys(["dlib", "mediapipe"][:n_detectors], 6)
