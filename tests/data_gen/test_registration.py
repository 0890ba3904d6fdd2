"""Iterated closest points: known motions come back from noisy, partial and cluttered scans."""

import numpy as np
import pytest
from faces import degrees_between
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from data_gen import registration
from data_gen.models.openhead import load_openhead

MOTION = Rotation.from_rotvec(np.deg2rad([6, 15, -8])).as_matrix()  # 18 degrees
SHIFT = np.array([12.0, -7.0, 400.0])


@pytest.fixture(scope="module")
def face():
    """Vertices of the front of the mean face, about 2,300, mm."""
    x, y, z = load_openhead().mean.T
    return load_openhead().mean[(z > 60) & (np.abs(x) < 60) & (np.abs(y) < 70)]


def icp(source, target, **options):
    return registration.icp(source, KDTree(target), **options)


def move(points):
    return points @ MOTION.T + SHIFT


def start_of(face):
    """No rotation, middle on middle: what a caller knows of a scan."""
    return move(face).mean(0) - face.mean(0)


def test_the_motion_of_an_exact_copy_is_recovered_exactly(face):
    result = icp(face, move(face), translation=start_of(face), trim=1.0)
    assert result.converged and result.rms < 1e-9
    np.testing.assert_allclose(result.rotation, MOTION, atol=1e-9)
    np.testing.assert_allclose(result.translation, SHIFT, atol=1e-8)


def test_a_noisy_scan_of_part_of_the_face_with_clutter_is_registered_by_trimming(face, rng):
    part = face[face[:, 0] < np.quantile(face[:, 0], 0.6)]  # as where hair hides a side
    scan = move(part) + rng.normal(0, 0.5, part.shape)
    scan = np.concatenate([scan, move(face.mean(0) + rng.uniform(-150, 150, (500, 3)))])
    trimmed, untrimmed = (icp(face, scan, translation=start_of(face), trim=t) for t in (0.5, 1.0))
    assert trimmed.converged and trimmed.n_iterations < 50  # 80 without longer steps
    assert trimmed.rms < 1.5
    off, off_untrimmed = (degrees_between(m.rotation, MOTION) for m in (trimmed, untrimmed))
    assert off < 1 < off_untrimmed


def test_a_better_start_needs_fewer_iterations_and_one_from_behind_rests_far_away(face):
    first = icp(face, move(face), translation=start_of(face), max_iterations=5)
    assert not first.converged and first.n_iterations == 5 and first.rms > 1e-3
    rest = icp(face, move(face), rotation=first.rotation, translation=first.translation)
    whole = icp(face, move(face), translation=start_of(face))
    assert rest.converged and rest.n_iterations < whole.n_iterations
    np.testing.assert_allclose(rest.rotation, MOTION, atol=1e-6)
    behind = Rotation.from_rotvec([0, np.pi, 0]).as_matrix()
    start = move(face).mean(0) - behind @ face.mean(0)
    assert icp(face, move(face), rotation=behind, translation=start).rms > 1.5


def test_a_reflection_is_never_returned(face, rng):
    tilted = face * (1, 1, 0.2)
    for target in (face * (-1, 1, 1), tilted * (1, 1, -1), rng.normal(0, 50, face.shape)):
        result = icp(tilted, target, max_iterations=20)
        assert np.linalg.det(result.rotation) == pytest.approx(1)
        np.testing.assert_allclose(result.rotation @ result.rotation.T, np.eye(3), atol=1e-9)


def test_a_rest_is_where_the_closest_points_pull_no_farther(face, rng):
    scan = move(face) + rng.normal(0, 1, face.shape)
    result = icp(face, scan, translation=start_of(face), trim=1.0)
    motion = {"rotation": result.rotation, "translation": result.translation}
    assert result.converged and icp(face, scan, **motion, trim=1.0, max_iterations=1).converged
    distance, _ = KDTree(scan).query(face @ result.rotation.T + result.translation)
    assert result.rms == pytest.approx(np.sqrt((distance**2).mean()), abs=1e-3)
