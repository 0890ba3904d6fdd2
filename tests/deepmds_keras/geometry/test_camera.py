"""Cameras and head poses: what was turned comes back, by the angles of the data."""

from dataclasses import replace

import numpy as np
import pytest
from faces import cameras, mean_landmarks

from deepmds_keras import InputError
from deepmds_keras.geometry.camera import (
    affine_cameras,
    camera_angles,
    head_pose,
    head_poses,
    orthographic_cameras,
    refit,
)
from deepmds_keras.geometry.views import project, rotations

N = 40


def random_cameras():
    rng = np.random.default_rng(1)
    return cameras(*(rng.uniform(-most, most, N) for most in (80, 60, 150)))


@pytest.fixture(scope="module")
def shape():
    """`(51, 3)` of the mean head, its middle anywhere but at the origin."""
    return mean_landmarks("ibug51") + [30.0, -20, 10]


def seen(shape, turned, scale=1.0, shift=(0, 0)):
    return scale * project(np.stack([shape] * len(turned.yaw)), turned) + shift


def test_affine_cameras_are_recovered_and_orthographic_are_the_nearest():
    rng = np.random.default_rng(0)
    shapes, truth = rng.normal(size=(8, 20, 3)), rng.normal(size=(8, 2, 4))
    views = shapes @ np.swapaxes(truth[..., :3], 1, 2) + truth[:, None, :, 3]
    np.testing.assert_allclose(affine_cameras(views, shapes), truth, atol=1e-9)
    found = orthographic_cameras(views, shapes)
    rotations, scales, translations = found.rotation, found.scale, found.translation
    np.testing.assert_allclose(rotations @ np.swapaxes(rotations, 1, 2), [np.eye(3)] * 8, atol=1e-9)
    assert np.allclose(np.linalg.det(rotations), 1)
    # No other scale is nearer to the affine camera.
    linear = scales[:, None, None] * rotations[:, :2]
    np.testing.assert_allclose(((truth[..., :3] - linear) * linear).sum((1, 2)), 0, atol=1e-8)
    seen = (linear @ shapes.mean(1)[..., None])[..., 0] + translations
    np.testing.assert_allclose(seen, views.mean(1))


def test_the_angles_scale_and_place_of_a_view_are_found(shape):
    turned, shift = random_cameras(), np.array([400.0, -300])
    views = seen(shape, turned, 2.5, shift)
    for i, view in enumerate(views):
        pose = head_pose(view, shape)
        assert pose.yaw == pytest.approx(turned.yaw[i])
        assert pose.pitch == pytest.approx(turned.pitch[i])
        assert pose.roll == pytest.approx(turned.roll[i])
        assert pose.scale == pytest.approx(2.5)
        assert pose.residual < 1e-12
        assert np.allclose(pose.project(shape), view)
        # Where the origin of the shape is seen; `project` keeps it where it is.
        assert np.allclose(pose.translation, shift)


def test_seen_from_straight_above_or_below_the_whole_turn_is_yaw():
    turned = rotations(cameras([40.0, -70], [90.0, -90], [20.0, 10]))
    yaw, pitch, roll = camera_angles(turned)
    assert not roll.any()
    np.testing.assert_allclose(rotations(cameras(yaw, pitch, roll)), turned, atol=1e-9)


def test_a_mirrored_view_is_refused_and_among_many_is_seen_from_behind(shape):
    views = seen(shape, cameras([10.0, 0, -20], [0.0, 5, 5], [0.0, 0, 10]))
    mirrored = views * [-1, 1]
    for view in mirrored:
        with pytest.raises(InputError, match="view must show the face from the front, .* mirrored"):
            head_pose(view, shape)
    upside_down = views * [1, -1]  # y down: a mirrored view of a head that stands on its top
    with pytest.raises(InputError, match="y up"):
        head_pose(upside_down[0], shape)
    poses = head_poses(np.concatenate([views, mirrored]), [shape] * 6)
    assert [abs(pose.yaw) > 90 for pose in poses] == 3 * [False] + 3 * [True]


@pytest.mark.parametrize(
    ("view", "message"),
    [
        (lambda v: np.where(v == v[3], np.nan, v), "views must be finite"),
        (lambda v: [*v.tolist(), [0]], "view must be one array. Received rows of unequal"),
        (lambda v: np.stack([v] * 2), r"of one face, .* Received shapes \(2, 51, 2\)"),
    ],
)
def test_what_is_no_view_of_the_shape_is_named(shape, view, message):
    with pytest.raises(InputError, match=message):
        head_pose(view(shape[:, :2]), shape)


def test_many_poses_are_those_of_each_face_with_their_perspective(shape):
    """And is fitted again where the shape is larger, near or far."""
    centred, turned = shape - shape.mean(0), random_cameras()
    far = head_poses(seen(centred, turned), np.stack([centred] * N))
    near = replace(far, scale=np.full(N, 2.5), perspective=np.linspace(0, 1 / 300, N))
    views = near.project(np.stack([centred] * N))
    assert len(near) == N and near[0], "the pose of one face has no length, but is there"
    fitted = head_poses(views, np.stack([centred] * N))
    off = np.sqrt(((fitted.project(centred) - views) ** 2).sum(2).mean(1))
    np.testing.assert_allclose(fitted.residual, off / np.ptp(views, axis=1).max(1))
    for i, pose in enumerate(near):
        assert np.allclose(pose.project(centred), views[i])
        assert np.allclose([pose.yaw, pose.pitch, pose.roll], camera_angles(far.rotation)[:, i])
        alone = head_pose(seen(centred, turned)[i], centred)
        for name, value in far[i].as_dict().items():
            assert np.allclose(getattr(alone, name), value, atol=1e-9), name
    views[:, :3] = np.nan
    again = refit(near, views, np.stack([1.2 * centred] * N))
    assert np.allclose(again.scale, 2.5 / 1.2, rtol=0.01)
    assert np.allclose(again.perspective, near.perspective / 1.2, rtol=0.01)
    off = again.project(np.stack([1.2 * centred] * N)) - views
    assert np.nanmax(np.abs(off)) < 0.5, "of some 300"
    with pytest.raises(TypeError):
        len(near[0])
