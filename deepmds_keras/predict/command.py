"""`deepmds predict`: the run over all sources, one after the other or side by side."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from joblib import Parallel, cpu_count, delayed
from tqdm import tqdm

from deepmds_keras.detection.detectors import DETECTORS, describe_detector
from deepmds_keras.io.errors import InputError
from deepmds_keras.landmarks.conversion import convert, scheme_of
from deepmds_keras.landmarks.y_axis import find_flipped
from deepmds_keras.photos import open_photo, photo_step
from deepmds_keras.predict.arguments import Options
from deepmds_keras.predict.detection import faces_in_photos
from deepmds_keras.predict.estimation import estimate
from deepmds_keras.predict.faces import Face, Found
from deepmds_keras.predict.index_page import write_index
from deepmds_keras.predict.landmark_files import read_faces
from deepmds_keras.predict.mesh_files import MESH_SUFFIXES, write_mesh
from deepmds_keras.predict.models import FAMILIES, describe_model, hash_weights, load_model, taken
from deepmds_keras.predict.outputs import FORMATS, output_files, write_output
from deepmds_keras.predict.page import write_page
from deepmds_keras.predict.picture import draw_face, draw_summary, write_picture
from deepmds_keras.predict.record import Record
from deepmds_keras.predict.sources import (
    check_folder,
    find_sources,
    is_landmark_file,
    is_photo,
    is_video,
    name_faces,
    name_sources,
    said_skipped,
)
from deepmds_keras.predict.videos import (
    find_in_video,
    portraits,
    read_stills,
    tell_tracks,
    write_landmark_video,
)
from deepmds_keras.video.smoothing import smooth_over_time

_SOURCES_PER_TASK = 8  # of a process: photos are large
_NAMED_FAULTS = 10  # of one source
_DRAWN_FACES = 24  # of one source, as many as the summary has: more are tables only


def run(options: Options, stopped: Callable[[], bool] = lambda: False) -> int:
    """Write the results of all sources; what cannot be used gets a line on stderr.

    Args:
        options: What is to be done.
        stopped: Asked after every source whether to go on.

    Returns:
        How many sources could not be used.

    Raises:
        InputError: Nothing can be done at all: no detector, no model, no folder.
        KeyboardInterrupt: It was stopped.
    """
    sources, errors, skipped = find_sources(options.sources, recursive=options.recursive)
    for error in errors:
        complain(error)
    if skipped:
        print(f"skipped: {_printable(said_skipped(skipped))}")
    kinds = (*(options.formats or FORMATS), "png", "html", "json", "mp4")
    suffixes = [f".{kind}" for kind in kinds]
    check_folder(options.out, sources, suffixes)
    record, names = Record(options, hash_weights(options.model)), name_sources(sources)
    todo = [
        (source, name)
        for source, name in zip(sources, names, strict=True)
        if not record.is_done(source, name) or options.force
    ]
    if len(todo) < len(sources):
        print(
            f"{len(sources) - len(todo)} of {len(sources)} sources are done already, by what "
            f"{_printable(str(record.path))} says; --force does them again."
        )
    if not todo:
        return len(errors)
    options, usable = _ready(options, todo)
    failed, shown = len(errors) + len(todo) - len(usable), []
    todo = usable
    record.save()  # now, lest all the work is done for a folder that takes no results
    with tqdm(total=len(todo), unit="source", disable=len(todo) == 1) as bar:
        for chunk in _in_chunks(options, todo):
            try:
                for source, faces, files in _results(options, chunk, record):
                    if isinstance(faces, InputError):
                        complain(faces)
                        failed += 1
                    else:
                        record.add(source)
                        shown += [face for face in _pictured(faces) if not face.is_gap]
                        if fault := _said_faults(source, faces):
                            complain(fault)
                            failed += 1
                        tqdm.write("\n".join(map(_printable, _told(source, faces, files))))
                    bar.update()
                    if stopped():
                        raise KeyboardInterrupt
            finally:
                record.save()
    together: dict[Path, Callable[[Path], object]] = {}
    if len(shown) > 1 and len(todo) > 1:
        photos = (None if face.photo is None else open_photo(face.photo) for face in shown)
        drawn = [*map(_in_photo, shown[:_DRAWN_FACES]), *shown[_DRAWN_FACES:]]
        together[options.out / "summary.png"] = lambda path: write_picture(
            path, draw_summary(drawn, photos)
        )
    if options.view and len(record.results()) > 1:
        together[options.out / "index.html"] = lambda path: write_index(path, record.results())
    try:
        record.claim([*together])
        record.save()
        for path, write in together.items():
            write(path)
            print(f"all together: {_printable(str(path))}")
    except InputError as error:
        complain(error)
        return failed + 1
    return failed


def complain(error: InputError, kind: str = "error") -> None:
    """One line on stderr."""
    tqdm.write(f"{kind}: {_printable(str(error))}", file=sys.stderr)


def _ready(
    options: Options, todo: list[tuple[Path, str]]
) -> tuple[Options, list[tuple[Path, str]]]:
    """The options with what they leave open, and what can be done with what is installed.

    What is lacking is said before the work begins. Without a detector files of landmarks are left.
    """
    if options.model not in (None, *FAMILIES):
        load_model(options.model)
    options = replace(options, jobs=cpu_count() if options.jobs == -1 else options.jobs)
    given = [(source, name) for source, name in todo if is_landmark_file(source)]
    if len(given) == len(todo):
        return options, todo
    detector = DETECTORS[options.detector]
    try:
        detector.open(options.landmarker)
    except InputError as error:
        if not given:
            raise
        n = len(todo) - len(given)
        kind = f"photo{'s' * (n > 1)}" + " or videos" * any(is_video(s) for s, _ in todo)
        complain(InputError(f"{n} {kind} cannot be used. {error}"))
        return options, given
    if not detector.commercial:
        tqdm.write(f"note: landmarks by {options.detector} ({detector.licence})", sys.stderr)
    return options, todo


def _results(
    options: Options, chunk: list[tuple[Path, str]], record: Record
) -> Iterator[tuple[Path, list[Face] | InputError, list[Path]]]:
    """Of each source its faces and files, as soon as these are written, or why there are none."""
    estimated = [_estimated(options, found) for found in _found(options, chunk)]
    for i, ((source, name), faces) in enumerate(zip(chunk, estimated, strict=True)):
        try:
            if not isinstance(faces, InputError):
                record.claim([*_writers(options, name, faces)], source)
        except InputError as error:
            estimated[i] = error
    record.save()  # before the files are there, lest the next run takes them for another's
    tasks = [
        delayed(_written)(options, name, faces)
        for (_, name), faces in zip(chunk, estimated, strict=True)
        if not isinstance(faces, InputError)
    ]
    written = _parallel(options, tasks)
    for (source, _), faces in zip(chunk, estimated, strict=True):
        files = [] if isinstance(faces, InputError) else next(written)
        if isinstance(files, InputError):
            faces, files = files, []
        yield source, faces, files


def _found(options: Options, chunk: list[tuple[Path, str]]) -> Iterator[Found | InputError]:
    """Landmarks of the faces of each source, or why there are none."""
    detector = describe_detector(options.detector, options.landmarker)
    photos = [source for source, _ in chunk if is_photo(source)]
    tasks = [
        delayed(faces_in_photos)(some, options.detector, options.landmarker, options.model)
        for some in _chunks(photos, -(-len(photos) // options.jobs))
    ]
    in_photos = iter([faces for task in _parallel(options, tasks) for faces in task])
    for source, name in chunk:
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
    few = len(found.names) <= _DRAWN_FACES
    try:
        with tqdm(total=len(found.names), unit="face", leave=False, disable=few) as bar:
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


def _written(options: Options, name: str, faces: list[Face]) -> list[Path] | InputError:
    """Writes tables, pictures and the page of one source."""
    writers = _writers(options, name, faces)
    try:
        for path, write in writers.items():
            write(path)
    except InputError as error:
        return error
    return [*writers]


def _writers(
    options: Options, name: str, faces: list[Face]
) -> dict[Path, Callable[[Path], object]]:
    """Files of one source, each with what writes it."""
    video = faces[0].moment is not None
    many = video or len(faces) > _DRAWN_FACES
    formats = options.formats or (("csv", "npz") if many else ("csv", "json", "ply", "obj"))
    model = describe_model(faces[0].scheme, options.model)
    shown = [face for face in _pictured(faces) if not face.is_gap]
    some = shown[:_DRAWN_FACES]

    @cache
    def photos() -> list[np.ndarray | None]:
        if video:
            return read_stills(some, options.every)
        return [open_photo(faces[0].photo) if faces[0].photo else None] * len(some)

    @cache
    def drawn() -> list[Face]:
        return [*map(_in_photo, some)]

    writers = {
        path: partial(write_output, faces=held, model=model)
        for path, held in output_files(options.out, name, faces, formats).items()
    }
    if video:
        writers[options.out / f"{name}.mp4"] = lambda path: write_landmark_video(
            path, faces, options.every
        )
    together = many and not video  # a picture each would take longer than all the rest
    if together:
        writers[options.out / f"{name}.png"] = lambda path: write_picture(
            path, draw_summary(shown, photos())
        )
    for i, face in enumerate([] if together else some):
        writers[options.out / f"{face.name}.png"] = lambda path, i=i: write_picture(
            path, draw_face(drawn()[i], photos()[i])
        )
    for face in shown if options.mesh else []:
        for suffix in MESH_SUFFIXES:
            path = options.out / f"{face.name}{suffix}"
            writers[path] = partial(write_mesh, face=face, model=model)
    if options.view:
        writers[options.out / f"{name}.html"] = lambda path: write_page(
            path, drawn(), photos(), mesh=options.mesh
        )
    return writers


def _pictured(faces: list[Face]) -> list[Face]:
    """The faces of one source of which there may be pictures: of a video one of each track."""
    return faces if faces[0].moment is None else portraits(faces, _DRAWN_FACES)


def _in_photo(face: Face) -> Face:
    """In the pixels of `open_photo`."""
    return face if face.photo is None else face.reduced(photo_step(face.photo))


def _told(source: Path, faces: list[Face], files: list[Path]) -> Iterator[str]:
    """Lines that tell the reader of a source."""
    named = [str(files[0]), *(file.name for file in files[1:4]), *["…"] * (len(files) > 4)]
    if faces[0].moment is not None:
        n_frames = len({face.moment.frame for face in faces})
        yield f"{source}: faces in {n_frames} frames → {', '.join(named)}"
        yield from tell_tracks(faces, _DRAWN_FACES)
        return
    seen = [face for face in faces if not face.is_gap]
    gaps = len(faces) - len(seen)
    counted = f"{len(seen)} face{'s' * (len(seen) > 1)}" + f", {gaps} gap{'s' * (gaps > 1)}" * (
        gaps > 0
    )
    yield f"{source}: {counted} → {', '.join(named)}"
    for face in seen[:_DRAWN_FACES]:
        yield f"  {face.name}: {face.angles}"
        yield from (f"    {note}" for note in face.notes)
    if len(seen) > _DRAWN_FACES:
        noted = sum(bool(face.notes) for face in seen[_DRAWN_FACES:])
        yield f"  pictures are of the first {_DRAWN_FACES}; {noted} of the others have notes"


def _said_faults(source: Path, faces: list[Face]) -> InputError | None:
    """The faces that are gaps because they cannot be used."""
    faults = {i: face.notes[0] for i, face in enumerate(faces, 1) if face.is_gap and face.notes}
    if not faults:
        return None
    some = [f"{i:,}" for i in faults][:_NAMED_FAULTS]
    return InputError(
        f"{source}: {len(faults):,} of {len(faces):,} faces cannot be used and are gaps: "
        f"{', '.join(some)}{', …' * (len(faults) > len(some))}. The first {min(faults.items())[1]}"
    )


def _parallel(options: Options, tasks: list) -> Iterator:
    """Results in order, each as soon as it is there."""
    return Parallel(min(options.jobs, max(len(tasks), 1)), return_as="generator")(tasks)


def _in_chunks(options: Options, todo: list[tuple[Path, str]]) -> list[list[tuple[Path, str]]]:
    """Sources that are done at once: many, but videos one by one, after the others."""
    videos = [(source, name) for source, name in todo if is_video(source)]
    others = [(source, name) for source, name in todo if not is_video(source)]
    return [*_chunks(others, options.jobs * _SOURCES_PER_TASK), *([video] for video in videos)]


def _printable(text: str) -> str:
    """On one line, whatever is in a file's name."""
    return "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)


def _chunks(items: list, size: int) -> list[list]:
    return [items[start : start + size] for start in range(0, len(items), max(size, 1))]
