"""CoMA: its meshes are read, and what cannot be used is listed with the reason."""

from itertools import product

import numpy as np
import pytest
from writers.models import corners_of
from writers.scans import write_ply

from data_gen.datasets.coma import find_meshes, load_coma
from data_gen.models.flame import LandmarkEmbedding
from data_gen.models.openhead import load_openhead
from deepmds_keras.errors import InputError

HEAD = load_openhead()
VERTICES, TRIANGLES = np.float32(HEAD.mean / 1000), HEAD.triangles
LANDMARKS = HEAD.landmarks["ibug51"]


@pytest.fixture(scope="module")
def embedding():
    """The open head's landmarks as corners of triangles."""
    return LandmarkEmbedding(*corners_of(LANDMARKS, TRIANGLES))


@pytest.fixture
def root(tmp_path):
    """Two subjects, two sequences, two frames each, whole millimetres apart."""
    for k, (subject, sequence, frame) in enumerate(product("AB", "ab", (5, 20))):
        file = tmp_path / subject / sequence / f"{sequence}.{frame:06}.ply"
        write_ply(file, VERTICES + np.float32(k / 100), TRIANGLES)
    return tmp_path


def test_landmarks_of_all_meshes_come_sorted_and_in_millimetres(root, embedding):
    (root / "A/a/._a.000005.ply").write_bytes(b"\x00\x05\x16\x07")  # as macOS leaves
    landmarks, skipped = load_coma(root, embedding)
    assert landmarks.dtype == np.float32 and skipped == []
    expected = HEAD.mean[LANDMARKS] + 10 * np.arange(8)[:, None, None]
    np.testing.assert_allclose(landmarks, expected, atol=1e-3)


def test_what_cannot_be_used_is_listed_with_its_reason(root, embedding):
    folder, shuffled = root / "A" / "a", np.random.default_rng(0).permutation(TRIANGLES)
    whole = (folder / "a.000005.ply").read_bytes()
    write_ply(folder / "shuffled.ply", VERTICES, shuffled)
    write_ply(folder / "millimetres.ply", VERTICES * 1000, TRIANGLES)
    write_ply(folder / "few.ply", VERTICES, TRIANGLES[:5])
    (folder / "truncated.ply").write_bytes(whole[:-100])
    landmarks, skipped = load_coma(root, embedding)
    assert len(landmarks) == 8
    reasons = {path.stem: reason for path, reason in skipped}
    assert reasons.keys() == {"shuffled", "millimetres", "few", "truncated"}
    assert "with FLAME's triangles in FLAME's order" in reasons["shuffled"]
    assert "must be a mesh of FLAME in metres" in reasons["millimetres"]
    assert "triangles must be those of FLAME" in reasons["few"]
    # What most of the meshes have is not right for that: the landmarks were 100 mm off.
    for path in find_meshes(root):
        write_ply(path, VERTICES, shuffled)
    with pytest.raises(InputError, match="None of 12 is; .*in FLAME's order. Received one .* mm"):
        load_coma(root, embedding)


def test_wide_open_mouths_are_not_refused(tmp_path, embedding):
    rng = np.random.default_rng(0)
    for k, weights in enumerate(np.eye(len(HEAD.expression_names))):
        shape = HEAD.shape(1.5 * rng.standard_normal(HEAD.n_identity), 1.5 * weights)
        write_ply(tmp_path / "s" / "q" / f"{k}.ply", np.float32(shape / 1000), TRIANGLES)
    assert load_coma(tmp_path, embedding)[1] == []


def test_processes_and_chunks_change_nothing(root, embedding, monkeypatch):
    (root / "B/a/a.000006.ply").touch()
    at_once, skipped = load_coma(root, embedding)
    monkeypatch.setattr("data_gen.datasets.coma._MESHES_PER_CHUNK", 4)
    done = []
    in_parts = load_coma(root, embedding, jobs=2, progress=done.append)
    assert done == [4, 4, 1]
    np.testing.assert_array_equal(in_parts[0], at_once)
    assert [path for path, _ in in_parts[1]] == [path for path, _ in skipped]
    assert len(skipped) == 1


def test_a_folder_without_meshes_is_refused(root):
    for path in (root / "absent", root / "A" / "a"):
        with pytest.raises(InputError, match=f"{path}: must hold .*SUBJECT/SEQUENCE/"):
            find_meshes(path)
