"""Painted surroundings, photos of them, and squares cut from photos."""

import numpy as np
import pytest

from data_gen.photographs import KINDS, clothes_depth, composite, crop, paint, photograph

SIZE = 109
TRIANGLE = np.array([[40.0, 30.0], [70.0, 30.0], [55.0, 50.0]])


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_is_a_picture_that_its_random_numbers_determine(kind):
    first, again, other = (paint(kind, SIZE, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert first.shape == (SIZE, SIZE, 3)
    assert 0 <= first.min() < first.max() <= 1
    assert np.array_equal(first, again)
    assert np.abs(first - other).mean() > 0.02
    composite(other, np.array([1.0, 0.5, 0]), np.indices((SIZE, SIZE))[0] - 40.0)
    assert np.array_equal(other[41:], np.broadcast_to([1, 0.5, 0], (SIZE - 41, SIZE, 3)))


def test_clothes_reach_from_the_collar_over_both_shoulders():
    for seed in range(10):
        front, behind = clothes_depth(200, np.array([90.0, 150.0]), 30, np.random.default_rng(seed))
        assert (front[153:, 85:95] > 0).all()  # below the neckline
        assert not (front[:147, 88:92] > 0).any()  # the neck is bare
        # Shoulders fall to either side, and are alike.
        assert (front[150] > 0)[[65, 115]].all() and not (front[150] > 0)[[2, 178]].any()
        assert np.array_equal(front[:, 80], front[:, 99])
        # The back of the collar is as wide as the neck, and ends behind the front.
        columns = np.flatnonzero((behind > 0).any(0))
        assert columns[0] >= 59 and columns[-1] <= 120
        assert (behind[140:150, 85:95] > 0).any()


def test_a_photo_is_the_picture_about_as_bright_with_noise():
    picture = np.linspace(0.1, 0.9, SIZE)[:, None, None] * np.ones((SIZE, SIZE, 3))
    photos = [photograph(picture, np.random.default_rng(seed)) for seed in range(10)]
    assert photos[0].dtype == np.uint8 and photos[0].shape == picture.shape
    means = np.mean(photos, axis=(0, 2, 3)) / 255
    assert np.corrcoef(means, picture[:, 0, 0])[0, 1] > 0.99
    assert abs(means.mean() - 0.5) < 0.1
    assert np.ptp([photo.mean() for photo in photos]) > 5


def photo(width=120, height=80):
    """Red grows to the right, green downwards, both by two a pixel."""
    y, x = np.mgrid[:height, :width]
    return np.uint8(np.stack([2 * x, 2 * y, 0 * x], axis=-1))


def test_landmarks_stay_on_what_they_marked_in_a_square_of_the_right_side():
    square, moved = crop(photo(), TRIANGLE, 96, 1.5)
    assert square.shape == (96, 96, 3)
    for before, after in zip(TRIANGLE, moved, strict=True):
        column, row = np.int64(after)
        assert np.allclose(square[row, column, :2], 2 * (before - 0.5), atol=3)
    assert np.ptp(moved[:, 0]) == 96 / 1.5
    assert np.allclose((moved.min(0) + moved.max(0)) / 2, 48)


def test_beyond_the_photo_its_edge_is_repeated():
    landmarks = np.array([[0.0, 10.0], [40.0, 10.0], [20.0, 70.0]])
    square, moved = crop(photo(), landmarks, 64, 2.0)
    assert moved[0, 0] > 16
    assert (square[:, 0, 0] == 0).all()  # left of the photo: the red of its first column
    assert (square[0, :, 1] == 0).all()
