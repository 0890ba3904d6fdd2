"""Faces as a detector finds them in photos: within the poses that are said, with its errors."""

from dataclasses import replace

import numpy as np
import pytest

from data_gen.models.openhead import load_openhead
from data_gen.views.photo_views import (
    DETECTOR_SD_MM,
    FIELD_OF_VIEW,
    PITCH,
    ROLL,
    YAW,
    sample_photo_views,
)
from data_gen.views.projections import project
from deepmds_keras.errors import InputError
from deepmds_keras.landmarks import load_scheme

N = 3000


@pytest.fixture(scope="module")
def model():
    return load_openhead()


@pytest.fixture(scope="module")
def drawn(model):
    return sample_photo_views(model, "ibug51", N, np.random.default_rng(0))


def lips_apart(landmarks):
    """Millimetres between the middles of the inner lips."""
    names = load_scheme("ibug51").names
    upper, lower = map(names.index, ("upper_lip_inner_middle", "lower_lip_inner_middle"))
    return np.linalg.norm(landmarks[:, upper] - landmarks[:, lower], axis=1)


def test_views_are_the_projected_landmarks_with_the_detectors_errors(drawn):
    views, landmarks, cameras = drawn
    assert views.shape == (N, 51, 2)
    assert landmarks.shape == (N, 51, 3)
    errors = views - project(landmarks, cameras)
    assert errors.std() == pytest.approx(DETECTOR_SD_MM, rel=0.02)
    assert abs(errors.mean()) < 0.05
    of_faces = errors.reshape(N, -1)
    # Of one landmark as of another, and no two of a face together.
    assert np.allclose(errors.std(0), DETECTOR_SD_MM, rtol=0.1)
    assert np.abs(np.corrcoef(of_faces[:, :20].T) - np.eye(20)).max() < 0.1


def test_a_detector_without_errors_sees_the_same_faces(model, drawn):
    views, landmarks, cameras = sample_photo_views(
        model, "ibug51", N, np.random.default_rng(0), detector_sd=0
    )
    assert np.array_equal(landmarks, drawn[1])
    assert np.array_equal(views, project(landmarks, cameras))


def test_poses_fill_their_ranges_evenly_to_either_side(drawn):
    cameras = drawn[2]
    for values, low, high in (
        (cameras.yaw, -YAW, YAW),
        (cameras.pitch, -PITCH, PITCH),
        (cameras.roll, -ROLL, ROLL),
        (cameras.field_of_view, 0, FIELD_OF_VIEW),
    ):
        assert low <= values.min()
        assert values.max() <= high
        counts, _ = np.histogram(values, 5, (low, high))
        assert (np.abs(counts / N - 0.2) < 0.03).all()
    assert (cameras.projection == 1).all()


def test_no_two_angles_go_together(drawn):
    cameras = drawn[2]
    angles = np.corrcoef([cameras.yaw, cameras.pitch, cameras.roll, cameras.field_of_view])
    assert np.abs(angles - np.eye(4)).max() < 0.08


def test_faces_differ_in_identity_and_expression(model, drawn):
    landmarks = drawn[1]
    mean = model.mean[model.landmarks["ibug51"]]
    eyes = np.linalg.norm(landmarks[:, 28] - landmarks[:, 19], axis=1)  # no expression moves them
    assert eyes.mean() == pytest.approx(np.linalg.norm(mean[28] - mean[19]), rel=0.01)
    assert eyes.std() > 1
    gaps = lips_apart(landmarks)
    closed = lips_apart(mean[None])[0]
    assert 0.2 < (gaps > closed + 5).mean() < 0.8
    assert gaps.max() > closed + 20


def test_the_generator_alone_decides(model, drawn):
    again = sample_photo_views(model, "ibug51", 50, np.random.default_rng(3))
    same = sample_photo_views(model, "ibug51", 50, np.random.default_rng(3))
    other = sample_photo_views(model, "ibug51", 50, np.random.default_rng(4))
    assert np.array_equal(again[0], same[0])
    assert np.array_equal(again[1], same[1])
    assert not np.array_equal(again[1], other[1])


def test_either_scheme_is_of_the_same_faces(model):
    both = [sample_photo_views(model, s, 20, np.random.default_rng(0)) for s in ("ibug51", "bfm72")]
    assert [views.shape[1] for views, _, _ in both] == [51, 72]
    assert np.array_equal(both[0][2].yaw, both[1][2].yaw)
    # The corners of the mouth are the same points: of iBUG 49 and 55, of the paper's 7 and 51.
    assert np.allclose(both[0][1][:, [31, 37]], both[1][1][:, [6, 50]], atol=6)


def test_what_cannot_be_drawn_is_named(model):
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="scheme must be one of .*ibug51.* Received 'dlib'"):
        sample_photo_views(model, "dlib", 2, rng)
    with pytest.raises(InputError, match="expressions must have the names of ARKit's blendshapes"):
        sample_photo_views(replace(model, expression_names=()), "ibug51", 2, rng)
