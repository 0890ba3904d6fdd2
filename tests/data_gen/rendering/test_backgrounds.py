"""Painted backgrounds: of many kinds, some smooth and some with sharp edges, every time alike."""

import numpy as np
import pytest

from data_gen.rendering.backgrounds import (
    KINDS,
    clothes_depth,
    draw_background,
    hair_depth,
    lay,
    paint,
)

SIZE = 109


def sharpest_edge(picture):
    """Largest step in brightness between two neighbours."""
    grey = picture.mean(-1)
    return max(np.abs(np.diff(grey, axis=axis)).max() for axis in (0, 1))


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_is_a_picture_that_its_random_numbers_determine(kind):
    first, again, other = (paint(kind, SIZE, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert first.shape == (SIZE, SIZE, 3)
    assert 0 <= first.min() < first.max() <= 1
    assert np.array_equal(first, again)
    assert np.abs(first - other).mean() > 0.02


def test_backgrounds_have_any_brightness_and_edges_of_any_sharpness():
    pictures = [draw_background(SIZE, np.random.default_rng(seed)) for seed in range(60)]
    brightness = [picture.mean() for picture in pictures]
    assert min(brightness) < 0.25 and max(brightness) > 0.7
    edges = np.array([sharpest_edge(picture) for picture in pictures])
    assert (edges > 0.15).mean() > 0.2  # as sharp as the outline of a face
    assert (edges < 0.05).mean() > 0.2


def test_a_layer_covers_what_lies_within_it_and_half_of_its_edge():
    picture = np.zeros((5, 5, 3))
    depth = np.broadcast_to(np.arange(-2.0, 3.0), (5, 5))
    lay(picture, np.array([1.0, 0.5, 0]), depth)
    assert np.allclose(picture[2, :, 0], [0, 0, 0.5, 1, 1])
    assert np.allclose(picture[..., 1], picture[..., 0] / 2)


def test_clothes_reach_from_the_collar_over_both_shoulders():
    for seed in range(10):
        front, behind = clothes_depth(200, np.array([90.0, 150.0]), 30, np.random.default_rng(seed))
        assert (front[153:, 85:95] > 0).all()  # below the neckline
        assert not (front[:147, 88:92] > 0).any()  # the neck is bare
        assert (front[-1] > 0).all()
        # Shoulders fall to either side, and are alike.
        assert (front[150] > 0)[[65, 115]].all() and not (front[150] > 0)[[2, 178]].any()
        assert np.array_equal(front[:, 80], front[:, 99])
        # The back of the collar is as wide as the neck, and ends behind the front.
        columns = np.flatnonzero((behind > 0).any(0))
        assert columns[0] >= 59 and columns[-1] <= 120
        assert (behind[140:150, 85:95] > 0).any()


def test_hair_surrounds_the_head_and_hangs_down():
    low, high = np.array([60.0, 40.0]), np.array([140.0, 160.0])
    lengths = []
    for seed in range(20):
        hair = hair_depth(200, low, high, np.random.default_rng(seed)) > 0
        assert hair[60:100, 75:125].all()
        rows, columns = np.nonzero(hair)
        assert 30 <= rows.min() <= 45
        assert 40 <= columns.min() < 72 and 128 < columns.max() <= 160
        lengths.append(rows.max())
    assert np.ptp(lengths) > 50  # bobs and long hair
