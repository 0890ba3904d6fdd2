"""The data set: what is in it, the same bytes from the same seed, and files that are refused."""

import numpy as np
import pytest

from data_gen.datasets import dataset as module
from data_gen.datasets.dataset import load_dataset, make_dataset, save_dataset
from data_gen.models.openhead import load_openhead
from data_gen.views.projections import project
from deepmds_keras.errors import InputError


@pytest.fixture(scope="module")
def model():
    return load_openhead()


@pytest.fixture
def faces(model):
    return make_dataset(model, 30, np.random.default_rng(0))


def test_views_are_projections_of_the_landmarks(faces):
    again = project(faces.landmarks.astype(float), faces.cameras)
    assert np.allclose(faces.views, again, atol=1e-3)
    assert len(faces) == 30


def test_faces_are_those_of_the_model(model, faces):
    restricted = model.restrict(model.landmarks["bfm72"])
    offsets = (faces.landmarks - restricted.mean).reshape(30, -1)
    basis = restricted.identity_basis_times_sd.reshape(model.n_identity, -1)
    fitted = np.linalg.lstsq(basis.T, offsets.T, rcond=None)[0]
    assert np.abs(basis.T @ fitted - offsets.T).max() < 1e-2


def test_progress_counts_every_face_and_chunks_change_nothing_but_the_draw(model, monkeypatch):
    monkeypatch.setattr(module, "_FACES_PER_CHUNK", 7)
    done = []
    faces = make_dataset(model, 30, np.random.default_rng(0), progress=done.append)
    assert done == [7, 7, 7, 7, 2]
    assert np.isfinite(faces.landmarks).all()
    assert len(np.unique(faces.landmarks[:, 0, 0])) == 30


def test_same_seed_same_bytes_and_round_trip(model, faces, tmp_path):
    save_dataset(tmp_path / "a.npz", faces)
    save_dataset(tmp_path / "b.npz", make_dataset(model, 30, np.random.default_rng(0)))
    loaded = load_dataset(tmp_path / "a.npz")
    assert np.array_equal(loaded.views, load_dataset(tmp_path / "b.npz").views)
    assert np.array_equal(loaded.landmarks, faces.landmarks)
    assert np.allclose(loaded.cameras.yaw, faces.cameras.yaw)
    assert loaded.description["model_sha256"] == model.sha256
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.npz", "b.npz"]


def test_unusable_files_are_refused(faces, tmp_path):
    path = tmp_path / "faces.npz"
    with pytest.raises(InputError, match="faces.npz does not exist"):
        load_dataset(path)
    save_dataset(path, faces)
    whole = path.read_bytes()
    path.write_bytes(whole[:-500])
    with pytest.raises(InputError, match="faces.npz must be a data set"):
        load_dataset(path)
    path.write_bytes(whole)
    with np.load(path) as file:
        arrays = dict(file)
    for key, value, message in (
        ("views", arrays["views"][:5], r"views must have shape \(30, 72, 2\)"),
        ("yaw", np.full(30, np.nan), "yaw must be finite"),
        ("projection", np.full(30, 9), "projection must be a number below 2"),
    ):
        np.savez(path, **(arrays | {key: value}))
        with pytest.raises(InputError, match=message):
            load_dataset(path)
    np.savez(path, **{key: value for key, value in arrays.items() if key != "views"})
    with pytest.raises(InputError, match="views must have shape .* Received nothing"):
        load_dataset(path)


def test_unknown_scheme_is_named(model):
    with pytest.raises(InputError, match=r"scheme must be one of .* Received 'dlib'"):
        make_dataset(model, 3, np.random.default_rng(0), scheme="dlib")


def test_a_flipped_byte_is_refused_or_harmless(faces, tmp_path):
    path = tmp_path / "faces.npz"
    save_dataset(path, faces)
    whole = path.read_bytes()
    refused = 0
    for position in np.random.default_rng(0).integers(0, len(whole), 100):
        damaged = bytearray(whole)
        damaged[position] ^= 0xFF
        path.write_bytes(damaged)
        try:
            load_dataset(path)
        except InputError:
            refused += 1
    assert refused > 90
