"""Views: directions of the angles, the limit of small fields of view, and both protocols."""

import numpy as np
import pytest

from data_gen.views.projections import (
    PROJECTIONS,
    Cameras,
    in_camera_frame,
    project,
    rotations,
    sample_cameras,
    sample_hard_cameras,
)
from deepmds_keras.errors import InputError


def cameras(n=1, **angles):
    zero = np.zeros(n)
    values = {"yaw": zero, "pitch": zero, "roll": zero, "field_of_view": zero}
    values |= {key: np.full(n, float(value)) for key, value in angles.items()}
    return Cameras(projection=(values["field_of_view"] > 0).astype(int), **values)


@pytest.fixture
def faces():
    return np.random.default_rng(0).normal(0, 50, (4, 20, 3))


def test_frontal_orthographic_view_is_x_and_y(faces):
    assert np.allclose(project(faces, cameras(4)), faces[..., :2])


@pytest.mark.parametrize(
    ("angle", "point", "seen"),
    [
        ({"yaw": 90}, [0, 0, 1], [1, 0]),  # the nose points to the subject's left, image right
        ({"pitch": 90}, [0, 0, 1], [0, 1]),  # looks up
        ({"roll": 90}, [0, 1, 0], [-1, 0]),  # the top leans to the subject's right
    ],
)
def test_direction_of_each_angle(angle, point, seen):
    assert np.allclose(project(np.array([[point, [0, 0, 0]]], float), cameras(**angle))[0, 0], seen)


def test_perspective_tends_to_orthographic(faces):
    orthographic = project(faces, cameras(4, yaw=20))
    gaps = [
        np.abs(project(faces, cameras(4, yaw=20, field_of_view=angle)) - orthographic).max()
        for angle in (8, 4, 2, 1e-6)
    ]
    assert gaps[0] > 1
    assert gaps[3] < 1e-5
    assert np.allclose(np.divide(gaps[:2], gaps[1:3]), 2, rtol=0.05)  # first order in the angle


def test_perspective_enlarges_what_is_near(faces):
    square = np.array([[[10, 10, 0], [-10, -10, 0], [10, 10, 40], [-10, -10, 40]]], float)
    view = project(square, cameras(field_of_view=30))[0]
    far, near = np.ptp(view[:2], axis=0), np.ptp(view[2:], axis=0)
    assert (near > 1.1 * far).all()


def test_turning_keeps_distances(faces):
    posed = in_camera_frame(faces, cameras(4, yaw=30, pitch=-20, roll=10))
    assert np.allclose(np.linalg.norm(posed, axis=2), np.linalg.norm(faces, axis=2))
    assert not np.allclose(posed, faces)


def test_papers_protocol():
    drawn = sample_cameras(20_000, np.random.default_rng(0))
    perspective = drawn.projection == 1
    assert abs(perspective.mean() - 0.5) < 0.02
    yaws, counts = np.unique(drawn.yaw[~perspective], return_counts=True)
    assert yaws.tolist() == [-45, 0, 45]
    assert (abs(counts / counts.sum() - 1 / 3) < 0.02).all()
    assert (drawn.pitch[~perspective] == 0).all()
    assert (drawn.field_of_view[~perspective] == 0).all()
    for values, low, high in (
        (drawn.yaw[perspective], -45, 0),
        (drawn.pitch[perspective], -30, 0),
        (drawn.field_of_view[perspective], 0, 5),
    ):
        assert low <= values.min() < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < values.max() <= high
        assert abs(values.mean() - (low + high) / 2) < 0.02 * (high - low)
    assert (drawn.roll == 0).all()


def test_posed_protocol_turns_the_faces_seen_in_perspective_too():
    paper, posed = (
        sample_cameras(20_000, np.random.default_rng(0), name) for name in ("paper", "posed")
    )
    perspective = paper.projection == 1
    assert (posed.projection == paper.projection).all()
    assert (posed.yaw == paper.yaw)[~perspective].all()
    turns, counts = np.unique((posed.yaw - paper.yaw)[perspective].round(9), return_counts=True)
    assert turns.tolist() == [-45, 0, 45]
    assert (abs(counts / counts.sum() - 1 / 3) < 0.02).all()
    # The camera stands at its azimuth and elevation whatever the turn of the face.
    turned = _about_y(posed.yaw - paper.yaw)
    assert np.allclose(rotations(posed), rotations(paper) @ turned)


def _about_y(yaw):
    cosine, sine, zero = np.cos(np.deg2rad(yaw)), np.sin(np.deg2rad(yaw)), 0 * yaw
    rows = [[cosine, zero, sine], [zero, zero + 1, zero], [-sine, zero, cosine]]
    return np.moveaxis(np.array(rows), 2, 0)


def test_released_protocol():
    drawn = sample_cameras(20_000, np.random.default_rng(0), "released")
    through_viewmtx = drawn.projection == 1
    assert abs(through_viewmtx.mean() - 0.3) < 0.02
    rest = drawn[~through_viewmtx]
    assert abs((rest.yaw != 0).mean() - 2 / 7) < 0.02  # two of three yaws in 30 of 70 %
    assert (rest.pitch == 0).all() and (rest.roll == 0).all()
    assert (drawn.field_of_view == 0).all()
    # Where the viewer stands, in the frame of the face, as `viewmtx` is told: about z, then down.
    x, y, z = rotations(drawn[through_viewmtx])[:, 2].T
    azimuth, elevation = np.rad2deg([np.arctan2(x, -y), np.arcsin(np.minimum(z, 1))])
    for values, low, high in ((azimuth, -45, 45), (elevation, 60, 90)):
        assert low <= values.min() < low + 1 and high - 1 < values.max() <= high
    assert abs(np.corrcoef(azimuth, elevation)[0, 1]) < 0.05


def test_same_random_numbers_same_cameras():
    first, again = (sample_cameras(50, np.random.default_rng(7)) for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(vars(first).values(), vars(again).values(),
                                                    strict=True))  # fmt: skip


def test_unknown_protocol_is_named():
    named = "protocol must be one of paper, released, posed. Received 'new'"
    with pytest.raises(InputError, match=named):
        sample_cameras(3, np.random.default_rng(0), "new")


def test_hard_views_are_as_far_turned_and_as_near_as_they_say():
    cameras = sample_hard_cameras(20_000, np.random.default_rng(0))
    for angles, most in ((cameras.yaw, 60), (cameras.pitch, 30), (cameras.roll, 20)):
        assert np.abs(angles).max() <= most
        np.testing.assert_allclose(np.quantile(angles, [0.25, 0.5, 0.75]) / most, [-0.5, 0, 0.5],
                                   atol=0.03)  # fmt: skip
    perspective = cameras.projection == PROJECTIONS.index("perspective")
    assert perspective.mean() == pytest.approx(0.5, abs=0.02)
    assert not cameras.field_of_view[~perspective].any()
    assert cameras.field_of_view[perspective].mean() == pytest.approx(30, abs=1)
    again = sample_hard_cameras(20_000, np.random.default_rng(0))
    assert np.array_equal(again.yaw, cameras.yaw)
