"""Faces in a video: their landmarks frame by frame, followed as tracks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import chain, islice
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import ArrayLike
from tqdm import tqdm

from deepmds_keras.landmarks import convert
from deepmds_keras.tool.detection import DETECTORS, describe_detector, to_ibug
from deepmds_keras.tool.predict.faces import Detections, FrameRef, name_faces
from deepmds_keras.tool.predict.models import target_scheme
from deepmds_keras.tool.predict.photo_faces import (
    SURE,
    best_turn,
    no_face,
    open_detector,
    turn_back,
)
from deepmds_keras.tool.predict.smoothing import smooth_over_time
from deepmds_keras.tool.predict.videos import Video

# Mean distance of the landmarks beyond which it is another face, relative to the larger side of
# their box. A fast head moves by 0.2 per frame; heads side by side are 1.2 and more apart.
_FAR = 0.75
_PATIENCE = 1.0  # seconds for which a face may be lost
# At a cut to another scene the picture changes by this part of its range, and this many times as
# much as in neighbouring frames. A face that moves by less than this there is the same: a flash.
_CUT, _CUT_RATIO, _CUT_STILL = 0.06, 4, 0.02
_CUT_GRID, _CUT_FRAMES = 48, 5  # compared pixels per side; neighbouring frames on either side
_WHOLE = 0.95  # least share of its frames: players skip some at the ends of a cut video
_TRIED_FRAMES = 8  # of a video, in all orientations
# Frames in a row, of which only the first is searched everywhere unless a face is lost. They are
# one task, so that the result does not depend on the number of processes.
_IN_A_ROW = 4
_MOST_BYTES = 1 << 30  # of the frames in memory at a time


def find_in_video(
    source: str | Path,
    name: str,
    *,
    detector: str,
    landmarker: str | None = None,
    model: str | None = None,
    every: int = 1,
    smooth: float | str = 0,
    jobs: int = 1,
) -> Detections:
    """Landmarks of the faces in a video, by frame and then by track, with few frames in memory.

    Args:
        source: The video.
        name: Name of its results.
        detector, landmarker, model: As for `find_in_photo`.
        every: 1 uses every frame, 2 every other.
        smooth: As for `smooth_over_time`, in used frames.
        jobs: Number of processes.

    Raises:
        InputError: It cannot be read, or no frame has a face.
    """
    video, frames, times, faces = Video(source, every), [], [], []
    changes, before = [], None
    frames_left, scheme = iter(video), DETECTORS[detector].scheme
    target = target_scheme(scheme, model)
    turn, in_a_row = _turn_of(video, detector, landmarker), max(1, _IN_A_ROW // every)
    bar = tqdm(total=video.n_frames, unit="frame", leave=False, disable=None)
    rows_at_once = max(1, min(jobs, _MOST_BYTES // (in_a_row * video.frame_bytes)))
    find = delayed(_points_in)
    # Frames are sent to the processes through memory, not files.
    with Parallel(jobs, max_nbytes=None) as parallel, bar:
        while batch := list(islice(frames_left, in_a_row * rows_at_once)):
            images = [frame.image for frame in batch]
            rows = [images[i : i + in_a_row] for i in range(0, len(images), in_a_row)]
            detections = chain(*parallel(find(row, turn, detector, landmarker) for row in rows))
            faces += [to_ibug(convert(p, scheme, target), detector, target) for p in detections]
            frames += [frame.index for frame in batch]
            times += [frame.time for frame in batch]
            for picture in (_sampled(frame.image) for frame in batch):
                changes.append(0.0 if before is None else np.abs(picture - before).mean() / 255)
                before = picture
            bar.update(len(batch))
    counts = [len(here) for here in faces]
    if not any(counts):
        raise no_face(Path(source), detector, "in any frame")
    remarks = []
    if video.n_counted and len(frames) < _WHOLE * video.n_counted:
        remarks.append(f"damaged: {len(frames)} of {video.n_counted} frames could be read")
    tracks = np.concatenate(follow_faces(faces, times, find_cuts(changes)))
    landmarks = np.concatenate(faces)
    order = np.lexsort((tracks, np.repeat(frames, counts)))
    frame, time, track = (
        column[order] for column in (np.repeat(frames, counts), np.repeat(times, counts), tracks)
    )
    return Detections(
        source=Path(source),
        names=name_faces(name, len(landmarks)),
        scheme=target,
        landmarks=smooth_over_time(
            landmarks[order], frame, smooth, tracks=track, times=time, step=every
        ),
        frame_refs=[*map(FrameRef, frame.tolist(), time.tolist(), track.tolist())],
        detector=describe_detector(detector, landmarker),
        remarks=remarks,
    )


def find_cuts(changes: ArrayLike) -> np.ndarray:
    """Whether a video cuts to another scene at each of its frames, `(n,)` bool.

    Changes are mean absolute differences from the frame before, as a part of the range.
    """
    by = np.asarray(changes)
    cuts = by > _CUT
    for i in np.flatnonzero(cuts).tolist():
        near = np.r_[by[max(i - _CUT_FRAMES, 1) : i], by[i + 1 : i + 1 + _CUT_FRAMES]]
        cuts[i] = not len(near) or by[i] > _CUT_RATIO * np.median(near)
    return cuts


def follow_faces(
    faces: Sequence[np.ndarray], times: Sequence[float], cuts: Iterable[bool]
) -> list[np.ndarray]:
    """Assign the faces of all frames to tracks, one for each person in view.

    Tracks and faces of a frame are paired so that the landmarks move least (linear assignment). A
    track ends after a second without its face, or after the next frame if that is later; a person
    who returns then gets another. At a cut all tracks end but those whose face hardly moves.

    Args:
        faces: Landmarks `(n, L, 2)` of each frame; n may be 0.
        times: Time of each frame in seconds, increasing.
        cuts: Whether another scene begins, for each frame.

    Returns:
        For each frame the tracks of its faces, `(n,)` int, numbered from 1 as they appear.
    """
    from scipy.optimize import linear_sum_assignment  # slow to load, and not needed for photos

    known: dict[int, tuple[float, np.ndarray]] = {}  # when and where each was last seen
    tracks, n_tracks, before = [], 0, -np.inf
    for here, time, cut in zip(faces, times, cuts, strict=True):
        oldest, far = min(time - _PATIENCE, before), _CUT_STILL if cut else _FAR
        known = {track: last for track, last in known.items() if last[0] >= oldest}
        numbers = np.zeros(len(here), int)
        if known and len(here):
            last = np.stack([face for _, face in known.values()])
            costs = np.minimum(_distances(last, here), far)
            for row, column in zip(*linear_sum_assignment(costs), strict=True):
                if costs[row, column] < far:
                    numbers[column] = [*known][row]
        new = numbers == 0
        numbers[new] = n_tracks + 1 + np.arange(new.sum())
        n_tracks += new.sum()
        known = {} if cut else known
        known |= {int(track): (time, face) for track, face in zip(numbers, here, strict=True)}
        tracks.append(numbers)
        before = time
    return tracks


def _turn_of(video: Video, detector: str, landmarker: str | None) -> int:
    """Quarter turns to the left that show a video's faces upright, for `np.rot90`.

    Frames are tried, as photos are, until one has an upright face that is certain.
    """
    find, scheme = open_detector(detector, landmarker), DETECTORS[detector].scheme
    step = max(1, (video.n_frames or 1) * video.every // _TRIED_FRAMES)
    turns = {0: 0.0}  # the best score of each
    for frame in islice(Video(video.path, step), _TRIED_FRAMES):
        score, turn, _, _ = best_turn(frame.image, find, scheme)
        turns[turn] = max(score, turns.get(turn, 0))
        if score >= SURE:
            break
    return max(turns, key=lambda turn: turns[turn])


def _points_in(
    images: Iterable[np.ndarray], turn: int, detector: str, landmarker: str | None
) -> list[np.ndarray]:
    """Landmarks `(n, L, 2)` of the faces in each of a few frames in a row, in any process."""
    find, before, found = open_detector(detector, landmarker), None, []
    for image in images:
        before, _ = find(np.ascontiguousarray(np.rot90(image, turn)), before)
        found.append(turn_back(before, turn, image))
    return found


def _distances(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """`(n, m)` mean distances of landmarks, relative to the mean size of the two faces."""
    apart = np.linalg.norm(first[:, None] - second, axis=-1).mean(-1)
    sizes = [np.ptp(faces, axis=1).max(-1) for faces in (first, second)]
    return 2 * apart / (sizes[0][:, None] + sizes[1])


def _sampled(image: np.ndarray) -> np.ndarray:
    """A sample of an image's pixels, `(48, 48, 3)`."""
    rows, columns = (np.linspace(0, side - 1, _CUT_GRID).astype(int) for side in image.shape[:2])
    return image[np.ix_(rows, columns)].astype(np.float32)
