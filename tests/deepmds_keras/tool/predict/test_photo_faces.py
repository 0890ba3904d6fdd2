"""Any detector finds the landmarks of photos, whichever side is up; its errors are known."""

import numpy as np
import pytest

from deepmds_keras.tool.detection import detector_sd, to_ibug
from deepmds_keras.tool.predict.photo_faces import find_upright


@pytest.mark.parametrize("unsure", [0.0, 0.8])
@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_a_photo_that_lies_on_its_side_is_turned_and_its_landmarks_turned_back(quarters, unsure):
    """A detector of a white spot in the left upper quarter of a photo that is higher than wide."""
    looked_at = []

    def detect(photo):
        looked_at.append(photo.shape)
        y, x = np.argwhere(photo[..., 0]).mean(0) + 0.5
        height, width = photo.shape[:2]
        upright = height > width and x < width / 2 and y < height / 2
        # One that is wrong, and less sure, where the photo is not upright.
        score = 0.95 if upright else unsure
        return np.full((1, 68, 2), (x, y) if upright else (3, 3)), np.array([score])

    photo = np.zeros((120, 90, 3), np.uint8)
    photo[30:32, 20:24] = 255
    photo = np.rot90(photo, -quarters)
    faces, scores = find_upright(photo, detect)
    assert len(looked_at) == (4 if quarters else 1), "what is found upright is not turned"
    y, x = np.argwhere(photo[..., 0]).mean(0) + 0.5
    np.testing.assert_array_equal(faces, np.full((1, 68, 2), (x, y)))
    assert scores == [0.95]


@pytest.mark.parametrize("score", [1.0, np.nan])
def test_faces_come_from_left_to_right_with_their_scores(score):
    places = np.array([300.0, 20, 100])

    def detect(photo):
        return places[:, None, None] + np.zeros((3, 68, 2)), np.array([score, 0.1, 0.2])

    faces, scores = find_upright(np.zeros((50, 400, 3), np.uint8), detect)
    assert [*faces[:, 0, 0]] == [20, 100, 300]
    np.testing.assert_array_equal(scores, [0.1, 0.2, score])
    none = np.empty((0, 68, 2)), np.empty(0)
    assert [len(each) for each in find_upright(np.zeros((9, 9, 3)), lambda _: none)] == [0, 0]


def test_landmarks_of_mediapipe_move_with_the_face_and_those_of_dlib_stay():
    views = np.random.default_rng(0).normal(0, 90, (4, 51, 2)) + 300
    moved = to_ibug(views, "mediapipe", "ibug51") - views
    turn = np.array([[0.6, 0.8], [-0.8, 0.6]])
    again = to_ibug(3 * views @ turn + 70, "mediapipe", "ibug51") - (3 * views @ turn + 70)
    np.testing.assert_allclose(again, 3 * moved @ turn, atol=1e-9)
    assert 0 < np.abs(moved).max() < 0.3 * 90
    np.testing.assert_array_equal(to_ibug(views, "dlib", "ibug51"), views)
    np.testing.assert_array_equal(to_ibug(views, "mediapipe", "bfm72"), views)


def test_errors_of_each_detector_are_known_in_its_schemes():
    for detector, scheme, n in (("dlib", "ibug68", 68), ("mediapipe", "ibug51", 51)):
        sd = detector_sd(detector, scheme)
        assert sd.shape == (n,) and (sd > 0.02).all() and (sd < 0.5).all()
    assert detector_sd("mediapipe", "bfm72") is None
