"""`deepmds predict`: the run over all sources, one after the other or side by side."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from joblib import cpu_count, delayed
from tqdm import tqdm

from deepmds_keras.detection.detectors import DETECTORS
from deepmds_keras.errors import InputError
from deepmds_keras.photos import open_photo
from deepmds_keras.predict import source_files
from deepmds_keras.predict.arguments import Options
from deepmds_keras.predict.faces import Face
from deepmds_keras.predict.index_page import write_index
from deepmds_keras.predict.messages import complain, faults_of, lines_of, printable
from deepmds_keras.predict.models import FAMILIES, hash_weights, load_model
from deepmds_keras.predict.outputs import FORMATS
from deepmds_keras.predict.picture import draw_summary, write_picture
from deepmds_keras.predict.record import Record
from deepmds_keras.predict.source_faces import chunks, faces_of, parallel
from deepmds_keras.predict.source_files import in_photo, pictured, write_files, writers_of
from deepmds_keras.predict.sources import (
    check_folder,
    find_sources,
    is_landmark_file,
    is_video,
    name_sources,
    said_skipped,
)

_SOURCES_PER_TASK = 8  # of a process: photos are large


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
        print(f"skipped: {printable(said_skipped(skipped))}")
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
            f"{printable(str(record.path))} says; --force does them again."
        )
    if not todo:
        return len(errors)
    options, usable = _ready(options, todo)
    failed, shown = len(errors) + len(todo) - len(usable), []
    todo = usable
    record.save()  # now, lest all the work is done for a folder that takes no results
    hidden = len(todo) == 1 or None  # None: where there is no terminal
    with tqdm(total=len(todo), unit="source", disable=hidden) as bar:
        for chunk in _in_chunks(options, todo):
            try:
                for source, faces, files in _results(options, chunk, record):
                    if isinstance(faces, InputError):
                        complain(faces)
                        failed += 1
                    else:
                        record.add(source)
                        shown += [face for face in pictured(faces) if not face.is_gap]
                        if fault := faults_of(source, faces):
                            complain(fault)
                            failed += 1
                        tqdm.write("\n".join(map(printable, lines_of(source, faces, files))))
                    bar.update()
                    if stopped():
                        raise KeyboardInterrupt
            finally:
                record.save()
    return failed + _written_together(options, record, shown if len(todo) > 1 else [])


def _written_together(options: Options, record: Record, shown: list[Face]) -> int:
    """Write the picture of the faces of several sources, and the page that leads to all pages.

    Returns:
        1 if one cannot be written, else 0.
    """
    together: dict[Path, Callable[[Path], object]] = {}
    if len(shown) > 1:
        photos = (None if face.photo is None else open_photo(face.photo) for face in shown)
        some = source_files.DRAWN_FACES
        drawn = [*map(in_photo, shown[:some]), *shown[some:]]
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
            print(f"all together: {printable(str(path))}")
    except InputError as error:
        complain(error)
        return 1
    return 0


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
    estimated = faces_of(options, chunk)
    for i, ((source, name), faces) in enumerate(zip(chunk, estimated, strict=True)):
        try:
            if not isinstance(faces, InputError):
                record.claim([*writers_of(options, name, faces)], source)
        except InputError as error:
            estimated[i] = error
    record.save()  # before the files are there, lest the next run takes them for another's
    tasks = [
        delayed(write_files)(options, name, faces)
        for (_, name), faces in zip(chunk, estimated, strict=True)
        if not isinstance(faces, InputError)
    ]
    written = parallel(options, tasks)
    for (source, _), faces in zip(chunk, estimated, strict=True):
        files = [] if isinstance(faces, InputError) else next(written)
        if isinstance(files, InputError):
            faces, files = files, []
        yield source, faces, files


def _in_chunks(options: Options, todo: list[tuple[Path, str]]) -> list[list[tuple[Path, str]]]:
    """Sources that are done at once: many, but videos one by one, after the others."""
    videos = [(source, name) for source, name in todo if is_video(source)]
    others = [(source, name) for source, name in todo if not is_video(source)]
    return [*chunks(others, options.jobs * _SOURCES_PER_TASK), *([video] for video in videos)]
