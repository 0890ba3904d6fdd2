"""Follows faces from frame to frame: which of one are those of the frames before."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

# Mean distance of the landmarks beyond which it is another face, in larger sides of their box. A
# head that moves fast comes to 0.2 from frame to frame; heads side by side are 1.2 and more apart.
_FAR = 0.75
_PATIENCE = 1.0  # seconds for which a face may be lost


def follow_faces(faces: Sequence[np.ndarray], times: Sequence[float]) -> list[np.ndarray]:
    """Number the tracks of the faces: one for each face, as long as it is where it was.

    Of all pairings of the tracks with the faces of a frame the one is taken that moves the
    landmarks least (linear assignment). A track is given up after a second without its face, or
    after the next frame where that is later; who comes back then has another.

    Args:
        faces: Of each frame `(n, L, 2)` landmarks, n from 0.
        times: Of each frame, in seconds, growing.

    Returns:
        Of each frame `(n,)` int, the tracks of its faces, numbered from 1 as they appear.
    """
    from scipy.optimize import linear_sum_assignment  # slow to load, and photos do without

    tracks, n_tracks, known, before = [], 0, {}, -np.inf
    for found, time in zip(faces, times, strict=True):
        oldest = min(time - _PATIENCE, before)
        known = {track: last for track, last in known.items() if last[0] >= oldest}
        numbers = np.zeros(len(found), int)
        if known and len(found):
            costs = np.minimum(
                _distances(np.stack([last for _, last in known.values()]), found), _FAR
            )
            for row, column in zip(*linear_sum_assignment(costs), strict=True):
                if costs[row, column] < _FAR:
                    numbers[column] = [*known][row]
        new = numbers == 0
        numbers[new] = n_tracks + 1 + np.arange(new.sum())
        n_tracks += new.sum()
        known |= {int(track): (time, face) for track, face in zip(numbers, found, strict=True)}
        tracks.append(numbers)
        before = time
    return tracks


def _distances(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """`(n, m)` mean distances of landmarks, in mean sizes of the two faces."""
    apart = np.linalg.norm(first[:, None] - second, axis=-1).mean(-1)
    sizes = [np.ptp(faces, axis=1).max(-1) for faces in (first, second)]
    return 2 * apart / (sizes[0][:, None] + sizes[1])
