"""Videos as sources of the command: their faces, a row for each frame and face, and pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain, islice
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from tqdm import tqdm

from deepmds_keras.detection.detectors import describe_detector
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.landmarks.conversion import scheme_of
from deepmds_keras.predict.arguments import Options
from deepmds_keras.predict.detection import faces_in_images, no_face
from deepmds_keras.predict.faces import Face, Found, Moment
from deepmds_keras.predict.sources import name_faces
from deepmds_keras.predict.writing import new_file
from deepmds_keras.video.following import follow_faces
from deepmds_keras.video.frames import Frame, Video
from deepmds_keras.video.preview import write_preview
from deepmds_keras.video.smoothing import smooth_over_time

_FRAMES_PER_TASK = 2  # of a process: a frame may take 25 MB


def find_in_video(options: Options, source: Path, name: str) -> Found:
    """Landmarks of the faces in a video, by frame and then by track; memory holds a few frames.

    Args:
        options: Detector, frames, smoothing and processes.
        source: The video.
        name: Of its results.

    Raises:
        InputError: It cannot be read, or no frame has a face.
    """
    video, frames, times, counts = Video(source, options.every), [], [], []
    # In one piece: small arrays between those of the frames would keep their memory in pieces.
    points = bytearray()
    # Frames are sent to the processes, not left for them in files.
    with Parallel(options.jobs, max_nbytes=None) as parallel, _bar(video) as bar:
        for batch in _batches(video, options.jobs * _FRAMES_PER_TASK):
            tasks = (
                delayed(faces_in_images)(
                    [frame.image for frame in batch[start : start + _FRAMES_PER_TASK]],
                    options.detector,
                    options.landmarker,
                    options.model,
                )
                for start in range(0, len(batch), _FRAMES_PER_TASK)
            )
            for found in chain.from_iterable(parallel(tasks)):
                points += np.asarray(found, float).tobytes()
                counts.append(len(found))
            frames += [frame.index for frame in batch]
            times += [frame.time for frame in batch]
            bar.update(len(batch))
    if not any(counts):
        raise no_face(source, options.detector, "in any frame")
    landmarks = np.frombuffer(points).reshape(sum(counts), -1, 2)
    faces = np.split(landmarks, np.cumsum(counts)[:-1])
    tracks = np.concatenate(follow_faces(faces, times))
    frames, times = np.repeat(frames, counts), np.repeat(times, counts)
    order = np.lexsort((tracks, frames))
    frames, times, tracks = frames[order], times[order], tracks[order]
    landmarks = smooth_over_time(
        landmarks[order], frames, options.smooth, tracks=tracks, step=options.every
    )
    return Found(
        source=source,
        names=name_faces(name, len(landmarks)),
        scheme=scheme_of(landmarks.shape[1]),
        landmarks=landmarks,
        is_photo=False,
        moments=[*map(Moment, frames.tolist(), times.tolist(), tracks.tolist())],
        detector=describe_detector(options.detector, options.landmarker),
        notes=(video.damage,) if video.damage else (),
    )


def portraits(faces: Sequence[Face], most: int) -> list[Face]:
    """The face of each track that is seen most from the front; of many tracks, the longest."""
    longest = sorted(_by_track(faces), key=len, reverse=True)[:most]
    chosen = [min(seen, key=lambda face: np.hypot(face.pose.yaw, face.pose.pitch))
              for seen in longest]  # fmt: skip
    return sorted(chosen, key=lambda face: face.moment.track)


def read_stills(faces: Sequence[Face], every: int) -> list[np.ndarray]:
    """The whole frame of each face of a video, `(H, W, 3)` uint8 RGB.

    Raises:
        InputError: The video cannot be read any more.
    """
    video, images = Video(faces[0].source, every), {}
    for frame in islice(video, max(face.moment.frame for face in faces) // every + 1):
        if any(frame.index == face.moment.frame for face in faces):
            images[frame.index] = frame.image
    return [images[face.moment.frame] for face in faces]


def write_landmark_video(path: Path, faces: Sequence[Face], every: int) -> None:
    """Write the frames that were looked at with the landmarks of all tracks, whole or not at all.

    Raises:
        InputError: The video cannot be read any more, or the file cannot be written.
    """
    video, shown = Video(faces[0].source, every), {}
    for face in faces:
        shown.setdefault(face.moment.frame, {})[str(face.moment.track)] = face.landmarks
    with new_file(path) as file, _bar(video) as bar:

        def frames() -> Iterator[Frame]:
            for frame in video:
                yield frame
                bar.update()

        write_preview(file.name, frames(), shown, load_scheme(faces[0].scheme).polylines)


def tell_tracks(faces: Sequence[Face], most: int) -> Iterator[str]:
    """Lines on the first tracks of a video: when each is seen, and how the head turns."""
    tracks = _by_track(faces)
    for seen in tracks[:most]:
        first, last = seen[0].moment, seen[-1].moment
        yaws = [round(face.pose.yaw) for face in seen]
        noted = sum(bool(face.notes) for face in seen)
        yield (
            f"  track {first.track}: {first.time:.1f} to {last.time:.1f} s, found in {len(seen)} "
            f"frames{f', {noted} with notes' * (noted > 0)}; yaw {min(yaws):+}° to "
            f"{max(yaws):+}°"
        )
    if len(tracks) > most:
        yield f"  and {len(tracks) - most} more tracks; pictures are of the {most} longest"


def _by_track(faces: Sequence[Face]) -> list[list[Face]]:
    """Faces of each track, in the order of its number."""
    tracks: dict[int, list[Face]] = {}
    for face in faces:
        tracks.setdefault(face.moment.track, []).append(face)
    return [tracks[track] for track in sorted(tracks)]


def _bar(video: Video) -> tqdm:
    return tqdm(total=video.n_frames, unit="frame", leave=False, disable=None)


def _batches(video: Video, size: int) -> Iterator[list[Frame]]:
    frames = iter(video)
    while batch := list(islice(frames, size)):
        yield batch
