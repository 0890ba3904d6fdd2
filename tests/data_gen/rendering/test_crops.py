"""Squares cut from photos: what is in them, and where the landmarks are thereafter."""

import numpy as np

from data_gen.rendering.crops import crop


def photo(width=120, height=80):
    """Red grows to the right, green downwards, both by two a pixel."""
    y, x = np.mgrid[:height, :width]
    return np.uint8(np.stack([2 * x, 2 * y, 0 * x], axis=-1))


def test_landmarks_stay_on_what_they_marked():
    image = photo()
    landmarks = np.array([[40.0, 30.0], [70.0, 30.0], [55.0, 50.0]])
    square, moved = crop(image, landmarks, 96, 1.5)
    assert square.shape == (96, 96, 3)
    for before, after in zip(landmarks, moved, strict=True):
        column, row = np.int64(after)
        assert np.allclose(square[row, column, :2], 2 * (before - 0.5), atol=3)


def test_the_side_is_the_margin_times_the_box():
    landmarks = np.array([[40.0, 30.0], [70.0, 30.0], [55.0, 50.0]])
    _, moved = crop(photo(), landmarks, 90, 1.5)
    assert np.ptp(moved[:, 0]) == 90 / 1.5
    assert np.allclose((moved.min(0) + moved.max(0)) / 2, 45)


def test_beyond_the_photo_its_edge_is_repeated():
    landmarks = np.array([[0.0, 10.0], [40.0, 10.0], [20.0, 70.0]])
    square, moved = crop(photo(), landmarks, 64, 2.0)
    assert moved[0, 0] > 16
    assert (square[:, 0, 0] == 0).all()  # left of the photo: the red of its first column
    assert (square[0, :, 1] == 0).all()
