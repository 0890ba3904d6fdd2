"""Faces that the shipped lifters are trained on: both models, neither alone, errors as told."""

import numpy as np
import pytest

from data_gen.models.registry import load_model
from deepmds_keras.detection.errors import DetectorErrors
from deepmds_keras.normalisation import normalise
from experiments.pretrained.photo_faces import PhotoFaces


@pytest.fixture(scope="module")
def errors():
    rng = np.random.default_rng(1)
    return DetectorErrors(
        yaw=np.zeros(1),
        bias=rng.normal(0, 0.02, (1, 51, 2)),
        view=np.zeros((1, 51, 2)),
        read=np.zeros((1, 1, 51, 2)),
        write=np.zeros((1, 1, 51, 2)),
        components=rng.normal(0, 0.02, (1, 4, 51, 2)),
        rest=np.full((1, 51, 2), 0.01),
    )


@pytest.fixture(scope="module")
def model():
    return load_model("openhead", None, "ibug51")


def test_views_miss_the_shapes_by_as_much_as_is_told(model, errors):
    exact = PhotoFaces([model], "ibug51", [errors])
    views, shapes, sd = exact(3000, np.random.default_rng(0))
    assert views.shape == (3000, 51, 2) and shapes.shape == (3000, 51, 3) and sd.shape == (3000, 51)
    per_landmark = sd.std(1) > 1e-9
    assert 0.4 < per_landmark.mean() < 0.6, "half have the errors of the detector"
    assert sd[~per_landmark].min() > 0 and sd[~per_landmark].max() < 6.1


def test_faces_differ_more_than_those_of_the_model(model):
    rng = np.random.default_rng(0)
    _, shapes, _ = PhotoFaces([model], "ibug51")(2000, rng)
    centred = normalise(shapes) - normalise(shapes).mean(0)
    values = np.linalg.svd(centred.reshape(2000, -1) / np.sqrt(2000), compute_uv=False)
    n_of_model = model.n_identity + model.expression_basis.shape[0]
    assert values[min(n_of_model, 120)] > 1e-4, "no few components span them"


def test_models_take_equal_parts_in_random_order(model):
    other = load_model("openhead", None, "ibug51")
    larger = type(other)(**{**vars(other), "mean": 2 * other.mean})
    _, shapes, _ = PhotoFaces([model, larger], "ibug51")(400, np.random.default_rng(0))
    sizes = np.ptp(shapes, axis=1).max(1)
    large = sizes > 1.4 * np.quantile(sizes, 0.25)
    assert large.sum() == 200
    assert 60 < large[:200].sum() < 140, "batches hold faces of both"
