"""The camera of the fits: its derivatives are those of what it sees."""

import numpy as np
from scipy.spatial.transform import Rotation

from data_gen.fitting.orthographic_camera import N_POSE, OrthographicCamera


def test_derivatives_are_what_small_steps_change():
    rng = np.random.default_rng(0)
    turned = Rotation.from_euler("yxz", [20, -10, 5], degrees=True).as_matrix()
    camera = OrthographicCamera(turned, 1.7, np.array([30.0, -40.0]))
    points, basis = rng.normal(0, 40, (6, 3)), rng.normal(0, 3, (4, 6, 3))
    jacobian = camera.jacobian(points, basis)
    assert jacobian.shape == (N_POSE + 4, 6, 2)
    tiny = 1e-6
    for number, derivative in enumerate(jacobian):
        step = np.zeros(N_POSE + 4)
        step[number] = tiny
        moved = points + np.tensordot(step[N_POSE:], basis, 1)
        change = camera.moved(step).project(moved) - camera.project(points)
        np.testing.assert_allclose(change / tiny, derivative, atol=2e-3)


def test_it_looks_along_z_with_y_up():
    camera = OrthographicCamera(np.eye(3), 2.0, np.array([10.0, 20.0]))
    np.testing.assert_allclose(camera.project(np.array([1.0, 3.0, 99.0])), [12, 26])
