"""Landmark transfer: what was hidden is found, and two real head models agree."""

import numpy as np
import pytest
from places import SHARED
from scipy.spatial import ConvexHull

from data_gen.landmarks import load_basel_anchors, load_vertices
from data_gen.models.ict import load_ict
from data_gen.models.landmark_transfer import transfer_landmarks
from data_gen.models.mesh import largest_component, orient_outwards, vertex_normals
from data_gen.models.openhead import load_openhead, read_openhead
from deepmds_keras.errors import InputError

PUPILS = [4, 53]  # landmarks 5 and 54


@pytest.fixture(scope="module")
def head():
    return load_openhead()


@pytest.fixture(scope="module")
def anchors():
    return np.array([point["openhead"] for point in load_basel_anchors().values()])


def transfer(head, source_anchors, mean, triangles, target_anchors):
    return transfer_landmarks(
        head.mean,
        head.triangles,
        head.landmarks["bfm72"],
        source_anchors,
        mean,
        triangles,
        target_anchors,
    )


def skin_landmarks(head):
    """The pupils lie on the eyes, which are parts of their own and never chosen."""
    return np.setdiff1d(np.arange(72), PUPILS)


def test_landmarks_are_found_on_the_same_face_renumbered_turned_and_scaled(head, anchors):
    rng = np.random.default_rng(0)
    order = rng.permutation(head.n_vertices)
    number = np.argsort(order)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    mean = (head.mean @ turn * 0.01 + [1, 2, 3])[order]
    found = transfer(head, anchors, mean, number[head.triangles], number[anchors])
    on_skin = skin_landmarks(head)
    hidden = number[head.landmarks["bfm72"]]
    np.testing.assert_array_equal(found.vertices[on_skin], hidden[on_skin])
    assert found.snap[on_skin].max() < 0.1


def test_landmarks_are_found_on_another_person_of_the_same_mesh(head, anchors):
    person = head.shape(np.random.default_rng(1).normal(size=head.n_identity))
    found = transfer(head, anchors, person, head.triangles, anchors)
    on_skin = skin_landmarks(head)
    hidden = person[head.landmarks["bfm72"]]
    error = np.linalg.norm(person[found.vertices] - hidden, axis=1)[on_skin]
    assert np.median(error) < 1
    assert error.max() < 8


@pytest.mark.skipif(not SHARED.is_dir(), reason="../shared is absent")
@pytest.mark.parametrize("kind", ["names in the file", "eos"])
def test_open_head_landmarks_land_on_those_of_ict(head, kind):
    ict = load_ict(SHARED / "ict-facekit")
    with np.load(SHARED / "ict-facekit" / "ict_light.npz") as file:
        numbers = file["vertex_index"]
    if kind == "eos":
        scheme = load_vertices("ibug68")
        known = list(scheme.anchors["bfm2017"])
        source, target = scheme.vertices["openhead"][known], scheme.vertices["ict"][known]
    else:
        points = [point for point in load_basel_anchors().values() if "ict" in point]
        source, target = (np.array([p[model] for p in points]) for model in ("openhead", "ict"))
    found = transfer(head, source, ict.mean, ict.triangles, np.searchsorted(numbers, target))
    truth = ict.mean[ict.landmarks["bfm72"]]
    error = np.linalg.norm(ict.mean[found.vertices] - truth, axis=1)
    # ICT's eye opening has no skin, and its table holds a vertex of the lower lid for the pupil.
    error = np.delete(error, PUPILS)
    assert np.median(error) < 3  # measured: 2.2 (names), 2.5 (eos)
    # eos has no anchor at the ear: its jaw angles slide; measured: 8.9 (names), 15.6 (eos)
    assert error.max() < (17 if kind == "eos" else 10)


def test_vertices_are_distinct_even_where_landmarks_meet(head, anchors):
    twice = np.concatenate([head.landmarks["bfm72"], head.landmarks["bfm72"]])
    found = transfer_landmarks(
        head.mean, head.triangles, twice, anchors, head.mean, head.triangles, anchors
    )
    assert len(set(found.vertices)) == 144


def test_too_few_anchors_are_refused(head, anchors):
    with pytest.raises(InputError, match="at least 6 vertices. Received 5 and 5"):
        transfer(head, anchors[:5], head.mean, head.triangles, anchors[:5])


def test_anchors_in_one_plane_are_refused(head, anchors):
    flat = head.mean * [1, 1, 0]
    with pytest.raises(InputError, match="target_anchors must not lie in one plane"):
        transfer(head, anchors, flat, head.triangles, anchors)


def test_a_target_that_is_elsewhere_is_refused(head, anchors):
    away = head.mean.copy()
    rest = np.setdiff1d(np.arange(head.n_vertices), anchors)
    away[rest] += [0, 0, 1000]
    with pytest.raises(InputError, match="must be a face of the same kind"):
        transfer(head, anchors, away, head.triangles, anchors)


def test_orientation_is_that_of_outward_normals():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(200, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    simplices = ConvexHull(points).simplices
    a, b, c = points[simplices.T]
    inwards = np.einsum("td,td->t", np.cross(b - a, c - a), a) < 0
    simplices[inwards] = simplices[inwards][:, ::-1]
    for wound in (simplices, simplices[:, ::-1]):
        normals = vertex_normals(points, orient_outwards(points, wound))
        assert (np.einsum("vd,vd->v", normals, points) > 0.9).all()


def test_open_head_faces_outwards(head):
    np.testing.assert_array_equal(orient_outwards(head.mean, head.triangles), head.triangles)


def test_largest_component_is_the_skin(head):
    skin = largest_component(head.n_vertices, head.triangles)
    np.testing.assert_array_equal(skin, np.flatnonzero(read_openhead()["part"] == 0))
