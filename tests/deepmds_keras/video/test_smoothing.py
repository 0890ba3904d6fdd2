"""Smoothing over time: within runs of frames, never over a gap or from one face to another."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from deepmds_keras.video.smoothing import smooth_over_time


@pytest.fixture
def noise():
    return np.random.default_rng(0).normal(0, 1, (60, 51, 2))


def test_without_gaps_it_is_a_gaussian(noise):
    smooth = smooth_over_time(noise, np.arange(60), 2)
    assert np.allclose(smooth, gaussian_filter1d(noise, 2, axis=0, mode="nearest"))
    assert smooth.std() < 0.5 * noise.std()


def test_what_lies_beyond_a_gap_has_no_say(noise):
    frames = np.r_[0:20, 21:61]
    smooth = smooth_over_time(noise, frames, 3)
    other = np.concatenate([noise[:20], noise[20:] + 1000])
    assert np.allclose(smooth_over_time(other, frames, 3)[:20], smooth[:20])
    assert np.allclose(smooth[20:], smooth_over_time(noise[20:], np.arange(40), 3))


def test_faces_are_smoothed_each_by_itself_whatever_the_order_of_the_rows(noise):
    frames, tracks = np.repeat(np.arange(30), 2), np.tile([1, 2], 30)
    smooth = smooth_over_time(noise, frames, 2, tracks=tracks)
    for track in (1, 2):
        alone = smooth_over_time(noise[tracks == track], np.arange(30), 2)
        assert np.allclose(smooth[tracks == track], alone)
    order = np.random.default_rng(1).permutation(60)
    mixed = smooth_over_time(noise[order], frames[order], 2, tracks=tracks[order])
    assert np.allclose(mixed, smooth[order])


def test_frames_that_were_left_out_on_purpose_are_no_gap(noise):
    every_third = smooth_over_time(noise, 3 * np.arange(60), 2, step=3)
    assert np.allclose(every_third, smooth_over_time(noise, np.arange(60), 2))
    assert np.allclose(smooth_over_time(noise, 3 * np.arange(60), 2), noise)


def test_nothing_to_do_changes_nothing_and_not_the_argument(noise):
    before = noise.copy()
    assert np.array_equal(smooth_over_time(noise, np.arange(60), 0), noise)
    smooth_over_time(noise, np.arange(60), 5)
    assert np.array_equal(noise, before)
    assert smooth_over_time(noise[:0], np.arange(0), 2).shape == (0, 51, 2)
