"""Rings: one identity a subject, expressions and views of their own, data that are refused."""

from dataclasses import replace

import numpy as np
import pytest

from data_gen.datasets import dataset
from data_gen.datasets.dataset import load_dataset, save_dataset
from data_gen.datasets.rings import make_rings
from data_gen.models.openhead import load_openhead
from data_gen.views.projections import project
from deepmds_keras.errors import InputError

SUBJECTS, IMAGES = 7, 4


@pytest.fixture(scope="module")
def model():
    return load_openhead()


@pytest.fixture(scope="module")
def expression(model):
    rng = np.random.default_rng(5)
    return rng.uniform(0, 1, (SUBJECTS * IMAGES, len(model.expression_basis)))


@pytest.fixture(scope="module")
def rings(model, expression):
    return make_rings(model, SUBJECTS, IMAGES, expression, np.random.default_rng(0))


def test_images_of_a_subject_share_the_identity_and_nothing_else(rings):
    subjects = np.arange(SUBJECTS * IMAGES) // IMAGES
    identity = rings.identity
    assert np.array_equal(identity, identity[::IMAGES][subjects])
    assert len(np.unique(identity, axis=0)) == SUBJECTS
    assert len(np.unique(rings.expression, axis=0)) == SUBJECTS * IMAGES
    assert len(np.unique(rings.landmarks[:, 0], axis=0)) == SUBJECTS * IMAGES
    assert abs(identity.std() - 1) < 0.05
    yaw = rings.cameras.yaw.reshape(SUBJECTS, IMAGES)
    assert (yaw.std(1) > 0).sum() >= SUBJECTS - 1


def test_landmarks_are_the_models_and_views_their_projections(model, rings, expression):
    assert rings.landmarks.shape == (SUBJECTS * IMAGES, 51, 3)
    assert np.allclose(rings.expression, expression)
    shapes = model.shape(rings.identity.astype(float), expression)
    landmarks = shapes[:, model.landmarks["ibug51"]]
    assert np.allclose(rings.landmarks, landmarks, atol=1e-3)
    assert np.allclose(rings.views, project(landmarks, rings.cameras), atol=1e-3)


def test_same_seed_same_faces_in_a_file_and_in_smaller_chunks(
    model, rings, expression, tmp_path, monkeypatch
):
    monkeypatch.setattr(dataset, "_FACES_PER_CHUNK", 5)
    again = make_rings(model, SUBJECTS, IMAGES, expression, np.random.default_rng(0))
    assert np.allclose(again.landmarks, rings.landmarks, atol=1e-3)
    save_dataset(tmp_path / "rings.npz", rings)
    loaded = load_dataset(tmp_path / "rings.npz")
    assert np.array_equal(loaded.views, rings.views)
    assert loaded.description["images_per_subject"] == IMAGES


def test_unusable_arguments_are_refused(model, expression):
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match=r"expression must have shape \(28, 51\)"):
        make_rings(model, SUBJECTS, IMAGES, expression[:-1], rng)
    with pytest.raises(InputError, match="expression must be finite"):
        make_rings(model, SUBJECTS, IMAGES, expression * np.nan, rng)
    with pytest.raises(InputError, match="n_subjects and images_per_subject must be at least 1"):
        make_rings(model, 0, IMAGES, expression[:0], rng)
    with pytest.raises(InputError, match="scheme must be one of"):
        make_rings(model, SUBJECTS, IMAGES, expression, rng, scheme="ibug")
    with pytest.raises(InputError, match="protocol must be one of"):
        make_rings(model, SUBJECTS, IMAGES, expression, rng, protocol="none")
    neutral = replace(model, expression_basis=None)
    with pytest.raises(InputError, match="must have an expression basis"):
        make_rings(neutral, SUBJECTS, IMAGES, expression, rng)
