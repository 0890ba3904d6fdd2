"""Landmarks over time: smoothed within a face's frames, causally with little jitter and lag."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from deepmds_keras.tool.predict.smoothing import one_euro, smooth_over_time

RATE = 30


@pytest.fixture
def still():
    """Ten seconds of a face at rest, 200 pixels large, with errors of 1 % of that."""
    rng = np.random.default_rng(0)
    face = rng.uniform(0, 200, (51, 2))
    return face, face + rng.normal(0, 2, (10 * RATE, 51, 2))


def test_smoothing_is_a_gaussian_over_runs_of_one_face():
    noise = np.random.default_rng(0).normal(0, 1, (60, 51, 2))
    whole = smooth_over_time(noise, np.arange(60), 2)
    assert np.allclose(whole, gaussian_filter1d(noise, 2, axis=0, mode="nearest"))
    frames = np.r_[0:20, 21:61]
    other = np.concatenate([noise[:20], noise[20:] + 1000])
    parts = (smooth_over_time(each, frames, 3)[:20] for each in (noise, other))
    assert np.allclose(*parts), "what lies beyond a gap has no say"
    frames, tracks = np.repeat(np.arange(30), 2), np.tile([1, 2], 30)
    order = np.random.default_rng(1).permutation(60)
    smooth = smooth_over_time(noise[order], frames[order], 2, tracks=tracks[order])
    for track in (1, 2):
        alone = smooth_over_time(noise[tracks == track], np.arange(30), 2)
        rows = np.flatnonzero(tracks[order] == track)
        assert np.allclose(smooth[rows[frames[order][rows].argsort()]], alone)
    assert np.allclose(smooth_over_time(noise, 3 * np.arange(60), 2, step=3), whole)
    assert np.array_equal(smooth_over_time(noise, np.arange(60), 0), noise)


def test_extreme_smoothing_is_none_or_nearly_the_mean_of_both_ends():
    noise = np.random.default_rng(0).normal(0, 1, (60, 51, 2))
    assert np.array_equal(smooth_over_time(noise, np.arange(60), 1e-200), noise)
    smooth = smooth_over_time(noise, np.arange(60), 1e12)
    assert np.abs(smooth - (noise[0] + noise[-1]) / 2).max() < 0.2


def test_causal_smoothing_leaves_a_third_of_the_jitter_of_a_face_at_rest(still):
    face, seen = still
    smooth = smooth_over_time(seen, np.arange(len(seen)), "causal")
    after = slice(RATE, None)  # it begins with the first frame
    assert (smooth[after] - face).std() < (seen[after] - face).std() / 3


@pytest.mark.parametrize(("speed", "most_ms"), [(0.25, 100), (1, 35), (2, 20)])
def test_causal_smoothing_lags_less_the_faster_a_face_moves(still, speed, most_ms):
    """Speeds are in face sizes a second."""
    times = np.arange(len(still[1])) / RATE
    way = 200 * speed * times[:, None]
    moving = still[1] + np.stack([way, 0 * way], axis=-1)
    lag = (moving - one_euro(moving, times))[3 * RATE :, :, 0].mean() / (200 * speed)
    assert 0 < 1000 * lag < most_ms


def test_causal_smoothing_knows_nothing_of_later_frames_other_faces_or_the_unit(still):
    frames, seen = np.arange(len(still[1])), still[1]
    whole = smooth_over_time(seen, frames, "causal")
    assert np.array_equal(smooth_over_time(seen[:99], frames[:99], "causal"), whole[:99])
    assert np.allclose(smooth_over_time(7 * seen, frames, "causal"), 7 * whole)
    tracks = np.where(frames < 50, 1, 2)
    assert np.array_equal(smooth_over_time(seen, frames, "causal", tracks=tracks)[50], seen[50])
    assert np.array_equal(smooth_over_time(seen, frames, "causal", times=frames / RATE), whole)


def test_causal_smoothing_takes_the_time_between_frames_into_account(still):
    """Every third frame at a third of the rate is smoothed less."""
    face, seen = still
    times = np.arange(len(seen)) / RATE
    rare, dense = one_euro(seen[::3], times[::3]), one_euro(seen, times)
    assert (rare[RATE:] - face).std() > 1.2 * (dense[RATE:] - face).std()
