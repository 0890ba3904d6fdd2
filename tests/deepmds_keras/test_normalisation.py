"""The paper's unit, and the door at which landmarks are checked."""

import numpy as np
import pytest

from deepmds_keras import InputError, normalise
from deepmds_keras.checks import check_points
from deepmds_keras.normalisation import unit


def test_all_coordinates_of_a_face_share_one_scale():
    face = np.array([[0.0, 10.0, 4.0], [2.0, 20.0, 5.0], [1.0, 12.0, -5.0]])
    expected = (face + 5) / 25
    assert np.allclose(normalise(face), expected)
    assert np.allclose(normalise(np.stack([face, 3 * face - 7])), expected)
    low, size = unit(face)
    assert (low.item(), size.item()) == (-5, 25)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((2, 5, 3)), r"shape \(faces >= 1, landmarks >= 3, 2\)"),
        (np.zeros((0, 5, 2)), r"shape \(faces >= 1, landmarks >= 3, 2\)"),
        (np.zeros((2, 2, 2)), r"shape \(faces >= 1, landmarks >= 3, 2\)"),
        (np.ones((2, 5, 2)), "one point 5 times in face 0"),
        (np.arange(10.0).reshape(1, 5, 2), "straight line in face 0"),
        (np.array([["a", "b"]] * 3), "must hold numbers"),
    ],
)
def test_degenerate_landmarks_are_named(points, message):
    with pytest.raises(InputError, match=message):
        check_points(points, "views", 2)


def test_the_face_with_a_hole_is_named():
    points = np.random.default_rng(0).normal(size=(4, 6, 2))
    points[2, 3, 1] = np.nan
    with pytest.raises(InputError, match="views must be finite. .* in face 2"):
        check_points(points, "views", 2)


def test_a_single_face_becomes_a_batch():
    assert check_points(np.random.default_rng(0).normal(size=(6, 2)), "views", 2).shape == (1, 6, 2)


def test_equal_coordinates_have_no_unit():
    with pytest.raises(InputError, match="not all equal within a face"):
        normalise(np.ones((3, 4, 2)))
