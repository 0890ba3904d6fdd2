"""Smooths the landmarks of faces over time: about each frame, or causally, from those before it."""

from __future__ import annotations

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.validation import check_number

CAUSAL = "causal"
# Of the Gaussian: SciPy cuts it off at four s.d., so smaller ones, in rows, reach no other row; of
# larger ones, in lengths of the run, little but its first and last landmarks counts.
_LEAST, _MOST = 0.125, 10
RATE = 30  # rows per second where no times are known
# Of the One-Euro filter: cutoff of a face at rest in Hz, its growth with speed in Hz per face size
# a second, and cutoff of the speed in Hz, the authors'. The first two leave under a third of the
# jitter of landmarks whose errors are 1 % of a face at rest, with the least lag.
_CUTOFF, _GROWTH, _SPEED_CUTOFF = 0.5, 5.0, 1.0


def check_smooth(smooth: float | str) -> None:
    """Raise InputError unless it is `"causal"` or a number that `smooth_over_time` takes."""
    if isinstance(smooth, str) and smooth != CAUSAL:
        raise InputError(f'smooth must be a number or "{CAUSAL}". Received {smooth!r}.')
    if smooth != CAUSAL:
        check_number(smooth, "smooth", zero=True)


def smooth_over_time(
    landmarks: np.ndarray,
    frames: np.ndarray,
    smooth: float | str,
    *,
    tracks: np.ndarray | None = None,
    times: np.ndarray | None = None,
    step: int = 1,
) -> np.ndarray:
    """Smooth the landmarks of each face over every run of frames without a gap.

    Args:
        landmarks: `(n, L, d)`, a row for each face in each frame.
        frames: `(n,)` int, the frame of each row, in any order.
        smooth: Standard deviation in rows of a Gaussian about each row, beyond the ends of a run of
            its first and last landmarks; at most ten times the length of the run. Below 0.125 it
            changes nothing. `"causal"` is `one_euro`.
        tracks: `(n,)` int, the face of each row; None if all show one face.
        times: `(n,)` seconds, for `"causal"`; None if there are 30 frames a second.
        step: Distance from one frame to the next; a larger one is a gap.

    Returns:
        `(n, L, d)` float, in the order of the rows given.
    """
    smoothed = np.array(landmarks, float)
    if (smooth != CAUSAL and float(smooth) < _LEAST) or not len(smoothed):
        return smoothed
    from scipy.ndimage import gaussian_filter1d  # slow to load, and rarely needed

    tracks = np.zeros(len(smoothed), int) if tracks is None else tracks
    times = frames / RATE if times is None else times
    order = np.lexsort((frames, tracks))
    gaps = (np.diff(frames[order]) != step) | (np.diff(tracks[order]) != 0)
    for run in np.split(order, np.flatnonzero(gaps) + 1):
        if smooth == CAUSAL:
            smoothed[run] = one_euro(smoothed[run], times[run])
        else:
            sd = min(float(smooth), _MOST * len(run))
            smoothed[run] = gaussian_filter1d(smoothed[run], sd, axis=0, mode="nearest")
    return smoothed


def one_euro(landmarks: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Low-pass each coordinate, the less the faster it moves: the One-Euro filter.

    Casiez, Roussel and Vogel (2012), doi:10.1145/2207676.2208639. A frame depends on itself and
    those before it only, as it must while a video is being recorded.

    Args:
        landmarks: `(n, L, d)` of one face, frame by frame.
        times: `(n,)` seconds, not decreasing.

    Returns:
        `(n, L, d)`.
    """
    smooth, speed = np.array(landmarks, float), np.zeros(landmarks.shape[1:])
    sizes = np.ptp(landmarks, axis=1).max(-1)
    for k, seconds in enumerate(np.maximum(np.diff(times), 1e-6), 1):
        moved = (landmarks[k] - landmarks[k - 1]) / (sizes[k] * seconds)
        speed += _share(_SPEED_CUTOFF, seconds) * (moved - speed)
        share = _share(_CUTOFF + _GROWTH * np.abs(speed), seconds)
        smooth[k] = smooth[k - 1] + share * (landmarks[k] - smooth[k - 1])
    return smooth


def _share(cutoff: float | np.ndarray, seconds: float) -> float | np.ndarray:
    """What a new value counts in exponential smoothing with a cutoff in Hz."""
    return 1 / (1 + 1 / (2 * np.pi * cutoff * seconds))
