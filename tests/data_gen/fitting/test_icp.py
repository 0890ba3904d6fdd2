"""Iterated closest points: known motions come back from noisy, partial and cluttered scans."""

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from data_gen.fitting.icp import icp
from data_gen.models.openhead import load_openhead
from deepmds_keras.errors import InputError

MOTION = Rotation.from_rotvec(np.deg2rad([6, 15, -8])).as_matrix()  # 18 degrees
SHIFT = np.array([12.0, -7.0, 400.0])


@pytest.fixture(scope="module")
def face():
    """Vertices of the front of the mean face, about 2,300, mm."""
    model = load_openhead()
    x, y, z = model.mean.T
    return model.mean[(z > 60) & (np.abs(x) < 60) & (np.abs(y) < 70)]


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def move(points):
    return points @ MOTION.T + SHIFT


def moved(points, found):
    return points @ found.rotation.T + found.translation


def start_of(face):
    """No rotation, middle on middle: what a caller knows of a scan."""
    return move(face).mean(0) - face.mean(0)


def sampled_surface(n, rng):
    """Points of the front of the mean face evenly by area, not at its vertices: `(n, 3)`."""
    model = load_openhead()
    corners = model.mean[model.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middle = corners.mean(1)
    front = (middle[:, 2] > 50) & (normals[:, 2] > 0) & (np.abs(middle[:, 1]) < 80)
    area = np.linalg.norm(normals, axis=1) * front
    chosen = rng.choice(len(area), n, p=area / area.sum())
    return np.einsum("nk,nkd->nd", rng.dirichlet([1, 1, 1], n), corners[chosen])


def angle(a, b):
    return np.rad2deg(Rotation.from_matrix(a.T @ b).magnitude())


def test_the_motion_of_an_exact_copy_is_found_exactly(face):
    found = icp(face, move(face), translation=start_of(face), trim=1.0)
    assert found.converged and found.overlap == 1
    assert found.rms < 1e-9
    np.testing.assert_allclose(found.rotation, MOTION, atol=1e-9)
    np.testing.assert_allclose(moved(face, found), move(face), atol=1e-8)


def test_a_noisy_scan_of_part_of_the_face_with_clutter_is_registered(face, rng):
    surface = sampled_surface(9000, rng)
    seen = surface[surface[:, 0] < 10]  # as where hair or a turned head hides a side
    scan = move(seen) + rng.normal(0, 0.5, seen.shape)
    clutter = move(face.mean(0) + rng.uniform(-150, 150, (500, 3)))
    found = icp(face, np.concatenate([scan, clutter]), translation=start_of(face), trim=0.5)
    assert (face[:, 0] < 10).mean() < 0.6  # 40 % is missing
    assert found.converged and found.n_iterations < 50  # 80 without longer steps
    assert found.rms < 1.5  # the scan has a point every 2 mm
    assert angle(found.rotation, MOTION) < 1.5
    assert np.linalg.norm(moved(face, found) - move(face), axis=1).max() < 2
    assert found.overlap == pytest.approx(0.5, abs=1e-3)


def test_without_trimming_the_missing_part_spoils_the_motion(face):
    scan = move(face[face[:, 0] < np.quantile(face[:, 0], 0.6)])
    trimmed, untrimmed = (icp(face, scan, translation=start_of(face), trim=t) for t in (0.5, 1.0))
    assert angle(trimmed.rotation, MOTION) < 0.1 < 2 < angle(untrimmed.rotation, MOTION)


def test_pairs_beyond_the_largest_distance_are_left_out(face):
    scan = move(face[face[:, 0] < np.quantile(face[:, 0], 0.6)])
    found = icp(
        face,
        scan,
        rotation=MOTION,
        translation=SHIFT,
        trim=1.0,
        max_distance=1e-3,
    )
    assert found.overlap == pytest.approx(0.6, abs=1e-3)
    np.testing.assert_allclose(moved(face, found), move(face), atol=1e-8)


def test_a_finer_start_is_used(face):
    first = icp(face, move(face), translation=start_of(face), max_iterations=5)
    rest = icp(face, move(face), rotation=first.rotation, translation=first.translation)
    whole = icp(face, move(face), translation=start_of(face))
    assert rest.n_iterations < whole.n_iterations
    np.testing.assert_allclose(rest.rotation, MOTION, atol=1e-6)


def test_one_iteration_moves_the_source_onto_its_closest_points(face):
    few = face[::50]  # so far apart that each point's closest is its own copy
    turn = Rotation.from_rotvec([0, 0.01, 0.005]).as_matrix()
    found = icp(few, few @ turn.T + 0.2, trim=1.0, max_iterations=1)
    np.testing.assert_allclose(found.rotation, turn, atol=1e-9)
    assert found.rms < 1e-9
    assert not found.converged  # it moved by more than the tolerance


def test_too_few_iterations_say_that_they_have_not_converged(face):
    found = icp(face, move(face), translation=start_of(face), max_iterations=2)
    assert not found.converged and found.n_iterations == 2
    assert found.rms > 1
    converged = icp(face, move(face), translation=start_of(face))
    assert converged.converged and converged.rms < 1e-3


def test_a_start_out_of_reach_says_that_it_has_not_converged(face):
    found = icp(face, move(face), max_distance=20)
    assert not found.converged
    assert found.overlap == 0 and found.rms == np.inf
    np.testing.assert_array_equal(found.rotation, np.eye(3))


def test_a_start_from_behind_rests_where_the_distance_is_large(face):
    behind = Rotation.from_rotvec([0, np.pi, 0]).as_matrix()
    start = move(face).mean(0) - behind @ face.mean(0)
    found = icp(face, move(face), rotation=behind, translation=start)
    assert found.rms > 1.5


def test_a_reflection_is_never_returned(face, rng):
    tilted = face * (1, 1, 0.2)
    for target in (face * (-1, 1, 1), tilted * (1, 1, -1), rng.normal(0, 50, face.shape)):
        found = icp(tilted, target, max_iterations=20)
        assert np.linalg.det(found.rotation) == pytest.approx(1)
        np.testing.assert_allclose(found.rotation @ found.rotation.T, np.eye(3), atol=1e-9)


def test_a_rest_is_where_the_closest_points_pull_no_farther(face, rng):
    scan = move(face) + rng.normal(0, 1, face.shape)
    found = icp(face, scan, translation=start_of(face), trim=1.0)
    again = icp(
        face,
        scan,
        rotation=found.rotation,
        translation=found.translation,
        trim=1.0,
        max_iterations=1,
    )
    assert found.converged and again.converged
    distance, _ = KDTree(scan).query(moved(face, found))
    assert found.rms == pytest.approx(np.sqrt((distance**2).mean()), abs=1e-3)


def test_a_tree_serves_as_its_points_do(face):
    points, tree = (
        icp(face, target, translation=SHIFT) for target in (move(face), KDTree(move(face)))
    )
    np.testing.assert_array_equal(points.rotation, tree.rotation)
    assert points.rms == tree.rms


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"source": np.zeros((2, 3))}, r"source must be at least 3 points.* \(2, 3\)"),
        ({"source": np.zeros((9, 2))}, r"source must be .* Received \(9, 2\)"),
        ({"source": np.full((9, 3), np.nan)}, "source must be finite"),
        ({"target": np.zeros((2, 3))}, "target must be at least 3 points"),
        ({"target": KDTree(np.zeros((9, 2)))}, r"target must be .* Received \(9, 2\)"),
        ({"target": np.full((9, 3), np.inf)}, "target must be finite"),
        ({"rotation": np.diag([1, 1, -1])}, "rotation must be"),
        ({"rotation": np.eye(3) * 2}, "rotation must be"),
        ({"rotation": np.eye(2)}, "rotation must be"),
        ({"translation": np.zeros(2)}, "translation must be"),
        ({"translation": np.full(3, np.nan)}, "translation must be"),
        ({"trim": 0}, r"trim must be in \(0, 1\]"),
        ({"trim": 1.1}, r"trim must be in \(0, 1\]"),
        ({"max_iterations": 0}, "max_iterations at least 1"),
        ({"tolerance": 0}, "tolerance positive"),
        ({"max_distance": 0}, "max_distance must be positive"),
    ],
)
def test_bad_arguments_are_refused(rng, changes, message):
    arguments = {"source": rng.normal(size=(9, 3)), "target": rng.normal(size=(9, 3))} | changes
    with pytest.raises(InputError, match=message):
        icp(arguments.pop("source"), arguments.pop("target"), **arguments)
