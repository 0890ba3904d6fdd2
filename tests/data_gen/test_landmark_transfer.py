"""Landmark transfer recovers hidden landmarks, and two real head models agree."""

from dataclasses import replace

import numpy as np
import pytest
from writers.scans import hull

from data_gen.landmarks import load_basel_anchors, load_vertices
from data_gen.models.ict import KEPT
from data_gen.models.landmark_transfer import transfer_landmarks
from data_gen.models.mesh import largest_component, orient_outwards, vertex_normals
from data_gen.models.openhead import read_openhead
from deepmds_keras.errors import InputError

# The pupils, landmarks 5 and 54, lie on the eyes, which are separate parts and never chosen.
ON_SKIN = np.setdiff1d(np.arange(72), [4, 53])


@pytest.fixture(scope="module")
def anchors():
    return np.array([point["openhead"] for point in load_basel_anchors().values()])


def test_landmarks_are_recovered_on_the_same_face_renumbered_turned_and_scaled(head, anchors):
    rng = np.random.default_rng(0)
    order = rng.permutation(head.n_vertices)
    number = np.argsort(order)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    target = head.restrict(order, number[head.triangles])
    target = replace(target, mean=target.mean @ turn * 0.01 + [1, 2, 3])
    vertices = transfer_landmarks(head, anchors, target, number[anchors])
    np.testing.assert_array_equal(vertices[ON_SKIN], number[head.landmarks["bfm72"]][ON_SKIN])
    twice = replace(head, landmarks={"bfm72": np.tile(head.landmarks["bfm72"], 2)})
    assert len(set(transfer_landmarks(twice, anchors, head, anchors))) == 144


@pytest.mark.parametrize("kind", ["names in the file", "eos"])
def test_open_head_landmarks_land_on_those_of_ict(head, ict, kind):
    if kind == "eos":
        scheme = load_vertices("ibug68")
        known = list(scheme.anchors["bfm2017"])
        source, target = scheme.vertices["openhead"][known], scheme.vertices["ict"][known]
    else:
        points = [point for point in load_basel_anchors().values() if "ict" in point]
        source, target = (np.array([p[model] for p in points]) for model in ("openhead", "ict"))
    vertices = transfer_landmarks(head, source, ict, np.searchsorted(KEPT, target))
    # ICT's eye opening has no skin, and its table holds a vertex of the lower lid for the pupil.
    error = ict.mean[vertices] - ict.mean[ict.landmarks["bfm72"]]
    error = np.linalg.norm(error, axis=1)[ON_SKIN]
    assert np.median(error) < 3  # measured: 2.2 (names), 2.5 (eos)
    # eos has no anchor at the ear: its jaw angles slide; measured: 8.9 (names), 15.6 (eos)
    assert error.max() < (17 if kind == "eos" else 10)


def test_what_does_not_fit_is_refused(head, anchors):
    away = head.mean + [0, 0, 1000]
    away[anchors] = head.mean[anchors]
    flat = head.mean * [1, 1, 0]
    for mean, message in (
        (flat, "target_anchors must not lie in one plane"),
        (away, "must be a face of the same kind"),
    ):
        with pytest.raises(InputError, match=message):
            transfer_landmarks(head, anchors, replace(head, mean=mean), anchors)


def test_orientation_is_that_of_outward_normals(head):
    points = np.random.default_rng(0).normal(size=(200, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    triangles = hull(points)
    for wound in (triangles, triangles[:, ::-1]):
        normals = vertex_normals(points, orient_outwards(points, wound))
        assert (np.einsum("vd,vd->v", normals, points) > 0.9).all()
    np.testing.assert_array_equal(orient_outwards(head.mean, head.triangles), head.triangles)


def test_largest_component_is_the_skin(head):
    skin = largest_component(head.n_vertices, head.triangles)
    np.testing.assert_array_equal(skin, np.flatnonzero(read_openhead()["part"] == 0))
