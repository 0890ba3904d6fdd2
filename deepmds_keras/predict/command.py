"""`deepmds predict`: the run over all sources, one after the other or side by side."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from joblib import Parallel, cpu_count, delayed
from scipy.ndimage import gaussian_filter1d
from tqdm import tqdm

from deepmds_keras.checks import check_points
from deepmds_keras.detection.mediapipe_landmarks import find_python
from deepmds_keras.errors import InputError
from deepmds_keras.landmarks.conversion import convert, scheme_of
from deepmds_keras.landmarks.uprightness import check_upright
from deepmds_keras.photos import open_photo
from deepmds_keras.predict.arguments import Options, parse
from deepmds_keras.predict.detection import SCHEME, faces_in_photos
from deepmds_keras.predict.faces import Face, Found
from deepmds_keras.predict.landmark_files import read_landmarks
from deepmds_keras.predict.outputs import FORMATS, write_outputs
from deepmds_keras.predict.page import write_page
from deepmds_keras.predict.picture import draw_face, draw_summary, write_picture
from deepmds_keras.predict.record import Record
from deepmds_keras.predict.sources import (
    check_folder,
    find_sources,
    is_photo,
    name_faces,
    name_sources,
)

_SOURCES_PER_TASK = 8  # of a process: photos are large, and MediaPipe takes a while to start
_DRAWN_FACES = 24  # of one source, and of the summary: more are tables only


def main(arguments: list[str] | None = None) -> None:
    """The command; ends the process with status 1 if a source could not be used."""
    options = parse(arguments)
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    os.environ.setdefault("TF_ENABLE_ONEDNN_OPTS", "0")  # its start-up notice; same sums everywhere
    logging.getLogger("tensorflow").setLevel(logging.ERROR)
    try:
        failed = run(options)
    except InputError as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit("Stopped. The same command goes on from here.")
    sys.exit(1 if failed else 0)


def run(options: Options) -> int:
    """Write the results of all sources; what cannot be used gets a line on stderr.

    Returns:
        How many sources could not be used.

    Raises:
        InputError: Nothing can be done at all: no detector, no model, no folder.
    """
    sources, errors = find_sources(options.sources)
    for error in errors:
        _complain(error)
    suffixes = [*(f".{name}" for name in options.formats or FORMATS), ".png", ".html"]
    check_folder(options.out, sources, suffixes)
    record, names = Record(options), name_sources(sources)
    named = dict(zip(sources, names, strict=True))
    wanted = [source for source in sources if not record.is_done(source, named[source])]
    if len(wanted) < len(sources):
        print(f"{len(sources) - len(wanted)} of {len(sources)} sources are done already.")
    if options.detector == "mediapipe" and any(map(is_photo, wanted)):
        options = replace(options, mediapipe_python=str(find_python(options.mediapipe_python)))
    jobs = min(cpu_count() if options.jobs == -1 else options.jobs, max(len(wanted), 1))
    failed, shown = len(errors), []
    with tqdm(total=len(wanted), unit="source", disable=len(wanted) < 2) as bar:
        for chunk in _chunks(wanted, jobs * _SOURCES_PER_TASK):
            for source, result in _results(options, chunk, named, jobs):
                if isinstance(result, InputError):
                    _complain(result)
                    failed += 1
                else:
                    faces, files = result
                    record.add(source, named[source], files)
                    shown += faces[: _DRAWN_FACES + 1 - len(shown)]
                    tqdm.write("\n".join(_said(source, faces, files)))
                bar.update()
            record.save()
    if len(shown) > 1 and len(wanted) > 1:
        photos = (None if face.photo is None else open_photo(face.photo) for face in shown)
        path = options.out / "summary.png"
        write_picture(path, draw_summary(shown, photos))
        print(f"all faces: {path}")
    return failed


def _results(
    options: Options, sources: list[Path], named: dict[Path, str], jobs: int
) -> Iterator[tuple[Path, tuple[list[Face], list[Path]] | InputError]]:
    """Of each source its faces and files, or why there are none."""
    from deepmds_keras.predict.estimation import described, estimate  # TensorFlow

    found = list(_found(options, sources, named, jobs))
    estimated: list[list[Face] | InputError] = []
    for own in found:
        try:
            estimated.append(own if isinstance(own, InputError) else estimate(
                own, model=options.model, interocular=options.interocular, jobs=options.jobs
            ))  # fmt: skip
        except InputError as error:
            estimated.append(error)
    usable = [i for i, faces in enumerate(estimated) if not isinstance(faces, InputError)]
    tasks = (
        delayed(_write)(options, named[sources[i]], estimated[i],
                        described(estimated[i][0].scheme, options.model))
        for i in usable
    )  # fmt: skip
    written = dict(zip(usable, Parallel(min(jobs, max(len(usable), 1)))(tasks), strict=True))
    for i, (source, faces) in enumerate(zip(sources, estimated, strict=True)):
        yield source, (faces, written[i]) if i in written else faces


def _found(
    options: Options, sources: list[Path], named: dict[Path, str], jobs: int
) -> Iterator[Found | InputError]:
    """Landmarks of the faces of each source, or why there are none."""
    photos = [source for source in sources if is_photo(source)]
    tasks = [*_chunks(photos, -(-len(photos) // jobs) or 1)]
    python = options.mediapipe_python and Path(options.mediapipe_python)
    in_photos = iter(
        faces
        for task in Parallel(min(jobs, max(len(tasks), 1)))(
            delayed(faces_in_photos)(task, options.detector, python) for task in tasks
        )
        for faces in task
    )
    for source in sources:
        photo = is_photo(source)
        try:
            landmarks = next(in_photos) if photo else _read(source, options)
        except InputError as error:
            landmarks = error
        if isinstance(landmarks, InputError):
            yield landmarks
            continue
        scheme = SCHEME if photo else scheme_of(landmarks.shape[1])
        names = name_faces(named[source], len(landmarks))
        yield Found(source, names, scheme, landmarks, photo)


def _read(source: Path, options: Options) -> np.ndarray:
    """Landmarks of a file, in one of the two schemes that there are weights for."""
    landmarks = read_landmarks(source, y_up=options.y_up)
    scheme = scheme_of(landmarks.shape[1])
    check_upright(landmarks, scheme, str(source))
    if options.smooth and len(landmarks) > 1:
        landmarks = gaussian_filter1d(landmarks, options.smooth, axis=0, mode="nearest")
    landmarks = convert(landmarks, scheme, "bfm72" if scheme == "bfm72" else SCHEME)
    return check_points(landmarks, str(source), 2)


def _write(options: Options, name: str, faces: list[Face], model: dict[str, str]) -> list[Path]:
    """Tables, pictures and the page of one source."""
    many = len(faces) > _DRAWN_FACES
    formats = options.formats or (("csv", "npz") if many else ("csv", "json", "ply", "obj"))
    files = write_outputs(options.out, name, faces, formats, model)
    drawn = faces[:_DRAWN_FACES]
    photo = open_photo(faces[0].photo) if faces[0].photo else None
    for face in drawn:
        files.append(options.out / f"{face.name}.png")
        write_picture(files[-1], draw_face(face, photo))
    if options.view:
        files.append(options.out / f"{name}.html")
        write_page(files[-1], drawn, [photo] * len(drawn))
    return files


def _said(source: Path, faces: list[Face], files: list[Path]) -> Iterator[str]:
    yield f"{source}: {len(faces)} face{'s' * (len(faces) > 1)} → " + ", ".join(
        [str(files[0]), *(file.name for file in files[1:4])] + ["…"] * (len(files) > 4)
    )
    for face in faces[:_DRAWN_FACES]:
        pose = face.pose
        yield (
            f"  {face.name}: yaw {pose.yaw:+.0f}°, pitch {pose.pitch:+.0f}°, roll {pose.roll:+.0f}°"
        )
        yield from (f"    {note}" for note in face.notes)
    if len(faces) > _DRAWN_FACES:
        yield f"  pictures of the first {_DRAWN_FACES} of {len(faces)}"


def _complain(error: InputError) -> None:
    tqdm.write(f"error: {error}", file=sys.stderr)


def _chunks(items: list, size: int) -> Iterator[list]:
    return (items[start : start + size] for start in range(0, len(items), size))
