"""Smooths landmarks over time, but not over gaps."""

from __future__ import annotations

import numpy as np


def smooth_over_time(
    landmarks: np.ndarray,
    frames: np.ndarray,
    deviation: float,
    *,
    tracks: np.ndarray | None = None,
    step: int = 1,
) -> np.ndarray:
    """Landmarks smoothed by a Gaussian over each run of frames without a gap, one face at a time.

    At the ends of a run its first and last landmarks are taken to go on.

    Args:
        landmarks: `(n, L, d)`, a row for each face in each frame.
        frames: `(n,)` int, the frame of each row, in any order.
        deviation: Standard deviation in rows; 0 changes nothing.
        tracks: `(n,)` int, which face each row is of; None: all are of one.
        step: From one frame to the next; where more lies between two, there is a gap.

    Returns:
        `(n, L, d)` float, in the order of the rows given.
    """
    smooth = np.array(landmarks, float)
    if not deviation or not len(smooth):
        return smooth
    from scipy.ndimage import gaussian_filter1d  # slow to load, and seldom asked for

    tracks = np.zeros(len(smooth), int) if tracks is None else tracks
    order = np.lexsort((frames, tracks))
    gaps = (np.diff(frames[order]) != step) | (np.diff(tracks[order]) != 0)
    for run in np.split(order, np.flatnonzero(gaps) + 1):
        smooth[run] = gaussian_filter1d(smooth[run], deviation, axis=0, mode="nearest")
    return smooth
