"""Procrustes alignment, the paper's unit, and the validation of landmarks."""

import numpy as np
import pytest
from scipy.spatial import procrustes
from scipy.stats import ortho_group

from deepmds_keras import InputError, align, normalise
from deepmds_keras.alignment import unit
from deepmds_keras.checks import check_points


@pytest.fixture
def target():
    return np.random.default_rng(0).normal(size=(5, 12, 3))


def test_without_scaling_size_is_kept(target):
    aligned = align(2 * target, target, scaling=False)
    assert np.allclose(aligned - aligned.mean(1, keepdims=True),
                       2 * (target - target.mean(1, keepdims=True)))  # fmt: skip


def test_agrees_with_scipy(target):
    source = target + np.random.default_rng(2).normal(0, 0.3, target.shape)
    for face, aligned in zip(range(len(target)), align(source, target), strict=True):
        _, _, disparity = procrustes(target[face], source[face])
        size = ((target[face] - target[face].mean(0)) ** 2).sum()
        assert np.isclose(((aligned - target[face]) ** 2).sum() / size, disparity)


def test_one_target_serves_all_sources(target):
    mean = target.mean(0)
    sources = mean @ ortho_group(3, seed=5).rvs(4)
    assert np.allclose(align(sources, mean), mean)


@pytest.mark.parametrize("source", [np.zeros((5, 11, 3)), np.zeros((4, 12, 3)), np.zeros((12, 3))])
def test_shapes_that_do_not_match_are_named(target, source):
    with pytest.raises(InputError, match=r"Received \(.*3\) and \(5, 12, 3\)"):
        align(source, target)


def test_all_coordinates_of_a_face_share_one_scale():
    face = np.array([[0.0, 10.0, 4.0], [2.0, 20.0, 5.0], [1.0, 12.0, -5.0]])
    expected = (face + 5) / 25
    assert np.allclose(normalise(np.stack([face, 3 * face - 7])), expected)
    low, size = unit(face)
    assert (low.item(), size.item()) == (-5, 25)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((2, 5, 3)), r"shape \(faces >= 1, landmarks >= 3, 2\)"),
        (np.zeros((0, 5, 2)), r"shape \(faces >= 1, landmarks >= 3, 2\)"),
        (np.zeros((2, 2, 2)), r"shape \(faces >= 1, landmarks >= 3, 2\)"),
        (np.array([["a", "b"]] * 3), "must hold numbers"),
        (None, "must hold numbers"),
        (np.full((2, 5, 2), 7e9), "one point 5 times in face 0"),
        (np.arange(10.0).reshape(1, 5, 2) * [1, -9], "straight line in face 0"),
        ([[[1, 2], [3, 4], [5]]], "unequal lengths"),
        (np.ma.masked_greater(np.random.default_rng(0).random((1, 5, 2)), 0.9), "NaN"),
    ],
)
def test_what_is_no_landmarks_is_named(points, message):
    with pytest.raises(InputError, match=message):
        check_points(points, "views", 2)
