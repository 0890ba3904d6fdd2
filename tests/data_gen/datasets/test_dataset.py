"""Data sets: what is in them, the same bytes from the same seed, and files that are refused."""

import numpy as np
import pytest

from data_gen.datasets import dataset
from data_gen.datasets.dataset import (
    load_dataset,
    make_dataset,
    make_performances,
    make_rings,
    save_dataset,
)
from data_gen.models.expressions import SEQUENCES
from data_gen.models.openhead import load_openhead
from deepmds_keras.errors import InputError
from deepmds_keras.files import read_npz
from deepmds_keras.geometry.views import project

MODEL, SUBJECTS, IMAGES = load_openhead(), 7, 4


def neutral(**options):
    return make_dataset(MODEL, 30, np.random.default_rng(0), **options)


def rings():
    return make_rings(MODEL, SUBJECTS, IMAGES, np.random.default_rng(0))


@pytest.mark.parametrize(("make", "scheme"), [(neutral, "bfm72"), (rings, "ibug51")])
def test_landmarks_are_those_of_the_model_and_views_their_projections(make, scheme):
    faces = make()
    expression = faces.expression if make is rings else None
    shapes = MODEL.shape(faces.identity.astype(float), expression)
    assert np.allclose(faces.landmarks, shapes[:, MODEL.landmarks[scheme]], atol=1e-3)
    views = project(faces.landmarks.astype(float), faces.cameras)
    assert np.allclose(faces.views, views, atol=1e-3)
    assert abs(faces.identity.std() - 1) < 0.05
    assert np.array_equal(make().views, faces.views)


def test_faces_are_sampled_in_chunks_and_counted(monkeypatch):
    monkeypatch.setattr(dataset, "_FACES_PER_CHUNK", 7)
    done = []
    faces = neutral(progress=done.append)
    assert done == [7, 7, 7, 7, 2]
    assert len(np.unique(faces.landmarks[:, 0, 0])) == 30


def test_images_of_a_ring_share_the_identity_and_nothing_else():
    faces = rings()
    identity = faces.identity.reshape(SUBJECTS, IMAGES, -1)
    assert np.array_equal(identity, np.repeat(identity[:, :1], IMAGES, axis=1))
    assert len(np.unique(identity[:, 0], axis=0)) == SUBJECTS
    assert len(np.unique(faces.expression, axis=0)) == SUBJECTS * IMAGES
    assert (faces.cameras.yaw.reshape(SUBJECTS, IMAGES).std(1) > 0).sum() >= SUBJECTS - 1


def test_every_subject_performs_every_sequence_from_neutral():
    n = 2 * len(SEQUENCES)
    identity, expression = make_performances(MODEL, 2, 4 * n + 5, np.random.default_rng(0))
    assert len(identity) == len(expression) == 4 * n + 5
    assert len(np.unique(identity, axis=0)) == 2
    starts = np.arange(n) * (4 * n + 5) // n
    assert not expression[starts].any() and expression.any(1).sum() > n


def test_a_file_gives_back_what_was_written(tmp_path):
    faces = rings()
    save_dataset(tmp_path / "a.npz", faces)
    loaded = load_dataset(tmp_path / "a.npz")
    for name in ("identity", "expression", "landmarks", "views", "description"):
        assert np.array_equal(getattr(loaded, name), getattr(faces, name))
    assert np.allclose(loaded.cameras.yaw, faces.cameras.yaw)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("views", np.zeros((5, 72, 2)), r"views must be .* shape \(30, 72, 2\). Received float64"),
        ("landmarks", None, "landmarks must be .* Received nothing"),
        ("identity", np.full((30, 3), "a"), "identity must be finite numbers"),
        ("yaw", np.full(30, np.nan), "yaw must be finite"),
        ("projection", np.full(30, 9), "projection must be a number below 2"),
        ("description", np.array("{"), "must be a data set .* JSONDecodeError"),
    ],
)
def test_unusable_files_are_refused(tmp_path, key, value, message):
    path = tmp_path / "faces.npz"
    save_dataset(path, neutral())
    arrays = read_npz(path)
    del arrays[key]
    np.savez(path, **arrays, **({} if value is None else {key: value}))
    with pytest.raises(InputError, match=message):
        load_dataset(path)
    path.write_bytes(path.read_bytes()[:-500])
    with pytest.raises(InputError, match="faces.npz must be a data set"):
        load_dataset(path)
