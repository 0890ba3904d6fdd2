"""Views sampled of given shapes: their angles, cameras and errors are those that were asked for."""

import numpy as np
import pytest

from deepmds_keras import InputError, sample_views
from deepmds_keras.geometry.camera import affine_cameras, head_poses
from deepmds_keras.lifting.sampling import read_faces


@pytest.fixture
def shapes():
    return np.random.default_rng(0).normal(0, 30, (60, 14, 3)) + (500, -20, 3)


def test_angles_are_drawn_up_to_those_given_and_shapes_go_with_their_views(shapes):
    views, shown = sample_views(shapes, 50, yaw=60, pitch=20, roll=0, field_of_view=0)
    assert np.array_equal(shown, np.repeat(shapes, 50, axis=0))
    poses = head_poses(views, shown)
    assert poses.residual.max() < 1e-9 and np.allclose(poses.scale, 1)
    for angle, most in ((poses.yaw, 60), (poses.pitch, 20)):
        assert most * 0.98 < np.abs(angle).max() <= most + 1e-6
        assert np.std(angle) == pytest.approx(most / np.sqrt(3), rel=0.05)
    assert np.abs(poses.roll).max() < 1e-6


def test_by_default_shapes_are_seen_from_all_sides(shapes):
    views, shown = sample_views(shapes, field_of_view=0)
    front = affine_cameras(views, shown)[..., :3]
    behind = np.cross(front[:, 0], front[:, 1])[:, 2] < 0
    assert len(views) == 40 * len(shapes) and 0.4 < behind.mean() < 0.6


def test_a_field_of_view_is_perspective_and_noise_has_its_size(shapes):
    far, shown = sample_views(shapes, 20, field_of_view=0)
    near, noisy = sample_views(shapes, 20)[0], sample_views(shapes, 20, noise=0.5)[0]
    assert head_poses(near, shown).residual.max() > 0.01 > head_poses(far, shown).residual.max()
    assert np.std(noisy - near) == pytest.approx(0.5, rel=0.02)
    others = sample_views(shapes, 20, rng=np.random.default_rng(1))[0]
    assert np.abs(others - near).max() > 1


def test_fit_takes_them(shapes):
    faces = read_faces(*sample_views(shapes, 3, noise=1.0), 1.0, 14)
    assert len(faces) == 180 and 0.005 < faces.sd.mean() < 0.05


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_views": 0}, "n_views must be a whole number of at least 1"),
        ({"yaw": -5}, "yaw must be finite and not negative"),
        ({"field_of_view": 180}, "field_of_view must be less than 180"),
        ({"noise": np.nan}, "noise must be finite and not negative"),
        ({"rng": -1}, "rng must be a whole number of at least 0"),
    ],
)
def test_unusable_options_are_named(shapes, options, message):
    with pytest.raises(InputError, match=message):
        sample_views(shapes, **options)


def test_shapes_without_a_landmark_are_refused(shapes):
    shapes[7, 3] = np.nan
    with pytest.raises(InputError, match="shapes must be finite. Received NaN .* in face 7"):
        sample_views(shapes)
