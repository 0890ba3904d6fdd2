"""Views of faces: directions of angles, protocols, the limit of small fields of view, hiding."""

import numpy as np
import pytest
from faces import cameras

from data_gen.views import (
    DETECTOR_SD_MM,
    FIELD_OF_VIEW,
    PITCH,
    ROLL,
    YAW,
    hidden_by_head,
    hidden_landmarks,
    sample_cameras,
    sample_hard_cameras,
    sample_photo_views,
)
from deepmds_keras.errors import InputError
from deepmds_keras.geometry.views import in_camera_frame, pose_and_project, project, rotations

N = 3000


@pytest.fixture
def faces():
    return np.random.default_rng(0).normal(0, 50, (4, 20, 3))


@pytest.fixture(scope="module")
def drawn(head):
    return sample_photo_views(head, "ibug51", N, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("angle", "point", "seen"),
    [
        ({}, [3, 5, 1], [3, 5]),
        ({"yaw": 90}, [0, 0, 1], [1, 0]),  # the nose points to the subject's left, image right
        ({"pitch": 90}, [0, 0, 1], [0, 1]),  # looks up
        ({"roll": 90}, [0, 1, 0], [-1, 0]),  # the top leans to the subject's right
    ],
)
def test_direction_of_each_angle(angle, point, seen):
    points = np.array([[point, [0, 0, 0]]], float)
    assert np.allclose(project(points, cameras(**angle))[0, 0], seen)
    posed = in_camera_frame(points, cameras(**angle))
    assert np.allclose(np.linalg.norm(posed, axis=2), np.linalg.norm(points, axis=2))


def test_perspective_tends_to_orthographic_and_enlarges_what_is_near(faces):
    orthographic = project(faces, cameras(yaw=20))
    gaps = [
        np.abs(project(faces, cameras(yaw=20, field_of_view=angle)) - orthographic).max()
        for angle in (8, 4, 2, 1e-6)
    ]
    assert gaps[0] > 1
    assert gaps[3] < 1e-5
    assert np.allclose(np.divide(gaps[:2], gaps[1:3]), 2, rtol=0.05)  # first order in the angle
    square = np.array([[[10, 10, -20], [-10, -10, -20], [10, 10, 20], [-10, -10, 20]]], float)
    view = project(square, cameras(field_of_view=30))[0]
    far, near = np.ptp(view[:2], axis=0), np.ptp(view[2:], axis=0)
    # From there a sphere about all four, of radius 24.5, fills the field of view.
    distance = np.sqrt(10**2 + 10**2 + 20**2) / np.sin(np.deg2rad(15))
    np.testing.assert_allclose(near / far, (distance + 20) / (distance - 20))


def test_any_points_are_seen_by_the_camera_that_the_landmarks_set_up(faces):
    camera = cameras(yaw=30, pitch=-20, roll=10, field_of_view=25)
    posed, seen = pose_and_project(faces, faces[:, :12], camera)
    np.testing.assert_allclose(posed, in_camera_frame(faces, camera))
    np.testing.assert_allclose(seen[:, :12, :2], project(faces[:, :12], camera))
    # What is nearer has the larger depth.
    assert (np.argsort(seen[..., 2], axis=1) == np.argsort(posed[..., 2], axis=1)).all()


def spread(values, low, high):
    """Whether values fill a range, evenly about its middle."""
    slack = 0.1 * (high - low)
    assert low <= values.min() < low + slack and high - slack < values.max() <= high
    assert abs(values.mean() - (low + high) / 2) < 0.02 * (high - low)


def test_papers_protocol():
    drawn = sample_cameras(20_000, np.random.default_rng(0))
    perspective = drawn.projection == 1
    assert abs(perspective.mean() - 0.5) < 0.02
    yaws, counts = np.unique(drawn.yaw[~perspective], return_counts=True)
    assert yaws.tolist() == [-45, 0, 45]
    assert (abs(counts / counts.sum() - 1 / 3) < 0.02).all()
    assert not drawn.pitch[~perspective].any() and not drawn.field_of_view[~perspective].any()
    spread(drawn.yaw[perspective], -45, 0)
    spread(drawn.pitch[perspective], -30, 0)
    spread(drawn.field_of_view[perspective], 0, 5)
    assert not drawn.roll.any()


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
    turns = rotations(cameras(posed.yaw - paper.yaw))
    assert np.allclose(rotations(posed), rotations(paper) @ turns)


def test_released_protocol():
    drawn = sample_cameras(20_000, np.random.default_rng(0), "released")
    through_viewmtx = drawn.projection == 1
    assert abs(through_viewmtx.mean() - 0.3) < 0.02
    rest = drawn[~through_viewmtx]
    assert abs((rest.yaw != 0).mean() - 2 / 7) < 0.02  # two of three yaws in 30 of 70 %
    assert not rest.pitch.any() and not rest.roll.any() and not drawn.field_of_view.any()
    # Where the viewer stands, in the frame of the face: about z from its forehead, then down.
    x, y, z = rotations(drawn[through_viewmtx])[:, 2].T
    azimuth, elevation = np.rad2deg([np.arctan2(x, y), np.arcsin(np.minimum(z, 1))])
    spread(azimuth, -45, 45)
    spread(elevation, 60, 90)
    assert (drawn.pitch[through_viewmtx] <= 1e-9).all(), "faces look down"
    assert abs(np.corrcoef(azimuth, elevation)[0, 1]) < 0.05


def plates(gap):
    """A small square in front of a large one, and points on the large one."""
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    front, back = 10 * square + (0, 0, gap), 40 * square
    points = np.array([[5, 5, 0], [-9, 2, 0], [15, 0, 0], [0, -30, 0]], float)
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    return np.concatenate([front, back, points]), np.concatenate([triangles, triangles + 4])


def test_what_is_well_behind_a_surface_is_hidden():
    hidden = hidden_landmarks(*plates(2.5), np.arange(12))
    assert hidden.tolist() == [False] * 8 + [True, True, False, False]
    for gap in (-30, 1.5):
        assert not hidden_landmarks(*plates(gap), np.arange(8, 12)).any()
    points, triangles = plates(30)
    points[:4] = points[:4][:, [2, 1, 0]] * (0, 1, 1) + (5, 0, 100)  # seen edge-on
    assert not hidden_landmarks(points, triangles, np.array([8])).any()


def test_a_turned_head_hides_its_far_side(head):
    landmarks = head.landmarks["ibug68"]
    turned = cameras([0, 60, -60])
    front, left, right = hidden_by_head(head, "ibug68", np.zeros((3, 1)), turned)
    assert not front[17:].any()
    x = head.mean[landmarks, 0]
    assert left.sum() > 10 and (x[left] > 0).mean() > 0.9
    assert right.sum() > 10 and (x[right] < 0).mean() > 0.9


def test_views_are_the_projected_landmarks_with_the_detectors_errors(head, drawn):
    views, landmarks, cameras = drawn
    errors = (views - project(landmarks, cameras)).reshape(N, -1)
    assert abs(errors.mean()) < 0.05
    # Of one landmark as of another, and no two of a face together.
    assert np.allclose(errors.std(0), DETECTOR_SD_MM, rtol=0.1)
    assert np.abs(np.corrcoef(errors[:, :20].T) - np.eye(20)).max() < 0.1
    rng = np.random.default_rng(0)
    exact, same, cameras = sample_photo_views(head, "ibug51", N, rng, detector_sd=0)
    assert np.array_equal(same, landmarks)
    assert np.array_equal(exact, project(landmarks, cameras))


def test_photo_poses_fill_their_ranges_and_no_two_angles_go_together(drawn):
    cameras = drawn[2]
    angles = np.stack([cameras.yaw, cameras.pitch, cameras.roll, cameras.field_of_view])
    for values, low, high in zip(
        angles, (-YAW, -PITCH, -ROLL, 0), (YAW, PITCH, ROLL, FIELD_OF_VIEW), strict=True
    ):
        spread(values, low, high)
    assert np.abs(np.corrcoef(angles) - np.eye(4)).max() < 0.08
    hard = sample_hard_cameras(N, np.random.default_rng(0))
    near = hard.projection == 1
    for values, low, high in ((hard.yaw, -60, 60), (hard.field_of_view[near], 0, 60)):
        spread(values, low, high)
    assert abs(near.mean() - 0.5) < 0.05 and not hard.field_of_view[~near].any()


def test_an_unknown_protocol_is_named():
    with pytest.raises(InputError, match="one of paper, released, posed. Received 'new'"):
        sample_cameras(3, np.random.default_rng(0), "new")
