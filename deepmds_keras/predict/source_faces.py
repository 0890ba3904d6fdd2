"""From sources to 3D faces: landmarks are found or read, then the shapes estimated."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from tqdm import tqdm

from deepmds_keras.detection.detectors import describe_detector
from deepmds_keras.errors import InputError
from deepmds_keras.landmarks.conversion import convert, scheme_of
from deepmds_keras.landmarks.y_axis import find_flipped
from deepmds_keras.predict import source_files
from deepmds_keras.predict.arguments import Options
from deepmds_keras.predict.detection import faces_in_photos
from deepmds_keras.predict.estimation import estimate
from deepmds_keras.predict.faces import Face, Found
from deepmds_keras.predict.landmark_files import read_faces
from deepmds_keras.predict.messages import complain
from deepmds_keras.predict.models import taken
from deepmds_keras.predict.sources import is_landmark_file, is_photo, is_video, name_faces
from deepmds_keras.predict.videos import find_in_video
from deepmds_keras.video.smoothing import smooth_over_time


def faces_of(options: Options, sources: list[tuple[Path, str]]) -> list[list[Face] | InputError]:
    """The 3D faces of each source, given with its name, or why there are none."""
    return [_estimated(options, found) for found in _found(options, sources)]


def _found(options: Options, sources: list[tuple[Path, str]]) -> Iterator[Found | InputError]:
    """Landmarks of the faces of each source, or why there are none."""
    detector = describe_detector(options.detector, options.landmarker)
    photos = [source for source, _ in sources if is_photo(source)]
    tasks = [
        delayed(faces_in_photos)(some, options.detector, options.landmarker, options.model)
        for some in chunks(photos, -(-len(photos) // options.jobs))
    ]
    in_photos = iter([faces for task in parallel(options, tasks) for faces in task])
    for source, name in sources:
        if is_video(source):
            yield _watched(options, source, name)
        elif is_landmark_file(source):
            yield _read(options, source, name)
        elif isinstance(landmarks := next(in_photos), InputError):
            yield landmarks
        else:
            scheme, names = scheme_of(landmarks.shape[1]), name_faces(name, len(landmarks))
            yield Found(source, names, scheme, landmarks, True, detector=detector)


def _read(options: Options, source: Path, name: str) -> Found | InputError:
    """Landmarks of a file, in a scheme that there are weights for; gaps for faults."""
    try:
        landmarks, faults = read_faces(source, y_up=options.y_up, image_size=options.image_size)
        n, scheme = len(landmarks), scheme_of(landmarks.shape[1])
        flipped = find_flipped(landmarks, scheme)
        landmarks[[*flipped]] = np.nan
        if np.isnan(landmarks).all():
            face, fault = min(flipped.items())
            raise InputError(f"{source}{f', face {face + 1} of {n}' * (n > 1)}: {fault}")
        rows = np.flatnonzero(~np.isnan(landmarks).any((1, 2)))
        landmarks[rows] = smooth_over_time(landmarks[rows], rows, options.smooth)
        target = taken(scheme, options.model)
        landmarks = convert(landmarks, scheme, target)
        return Found(source, name_faces(name, n), target, landmarks, False, faults | flipped)
    except InputError as error:
        return error


def _watched(options: Options, source: Path, name: str) -> Found | InputError:
    """Landmarks of a video; what a reader must know of it is said."""
    try:
        found = find_in_video(options, source, name)
    except InputError as error:
        return error
    for note in found.notes:
        complain(InputError(f"{source}: {note}"), "note")
    return found


def _estimated(options: Options, found: Found | InputError) -> list[Face] | InputError:
    if isinstance(found, InputError):
        return found
    n = len(found.names)
    hidden = n <= source_files.DRAWN_FACES or None  # None: where there is no terminal
    try:
        with tqdm(total=n, unit="face", leave=False, disable=hidden) as bar:
            faces = estimate(
                found,
                model=options.model,
                interocular=options.interocular,
                jobs=options.jobs,
                progress=bar.update,
            )
    except InputError as error:
        return error
    if found.moments is None:
        return faces
    faces = [
        replace(face, moment=moment) for face, moment in zip(faces, found.moments, strict=True)
    ]
    faces[-1] = replace(faces[-1], notes=faces[-1].notes + tuple(found.notes))
    return faces


def parallel(options: Options, tasks: list) -> Iterator:
    """Results in order, each as soon as it is there."""
    return Parallel(min(options.jobs, max(len(tasks), 1)), return_as="generator")(tasks)


def chunks(items: list, size: int) -> list[list]:
    """The items in order, so many at a time."""
    return [items[start : start + size] for start in range(0, len(items), max(size, 1))]
