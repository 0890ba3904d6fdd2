"""The files of one source: tables, pictures, meshes, the page, and what writes each."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.photos import open_photo, photo_step
from deepmds_keras.predict.arguments import Options
from deepmds_keras.predict.faces import Face
from deepmds_keras.predict.mesh_files import MESH_SUFFIXES, write_mesh
from deepmds_keras.predict.models import describe_model
from deepmds_keras.predict.outputs import output_files, write_output
from deepmds_keras.predict.page import write_page
from deepmds_keras.predict.picture import draw_face, draw_summary, write_picture
from deepmds_keras.predict.videos import portraits, read_stills, write_landmark_video

DRAWN_FACES = 24  # of one source, as many as the summary has: more are tables only


def write_files(options: Options, name: str, faces: list[Face]) -> list[Path] | InputError:
    """Write the files of one source, and return their paths, or why there are not all."""
    writers = writers_of(options, name, faces)
    try:
        for path, write in writers.items():
            write(path)
    except InputError as error:
        return error
    return [*writers]


def writers_of(
    options: Options, name: str, faces: list[Face]
) -> dict[Path, Callable[[Path], object]]:
    """Files of one source, each with what writes it."""
    video = faces[0].moment is not None
    many = video or len(faces) > DRAWN_FACES
    formats = options.formats or (("csv", "npz") if many else ("csv", "json", "ply", "obj"))
    model = describe_model(faces[0].scheme, options.model)
    shown = [face for face in pictured(faces) if not face.is_gap]
    some = shown[:DRAWN_FACES]

    @cache
    def photos() -> list[np.ndarray | None]:
        if video:
            return read_stills(some, options.every)
        return [open_photo(faces[0].photo) if faces[0].photo else None] * len(some)

    @cache
    def drawn() -> list[Face]:
        return [*map(in_photo, some)]

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


def pictured(faces: list[Face]) -> list[Face]:
    """The faces of one source of which there may be pictures: of a video one of each track."""
    return faces if faces[0].moment is None else portraits(faces, DRAWN_FACES)


def in_photo(face: Face) -> Face:
    """In the pixels of `open_photo`."""
    return face if face.photo is None else face.reduced(photo_step(face.photo))
