"""Photos and files of landmarks that a run reads, and the names of their results."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from deepmds_keras.io.errors import InputError
from deepmds_keras.predict.landmark_files import SUFFIXES as LANDMARK_SUFFIXES

PHOTO_SUFFIXES = (
    *(".avif", ".bmp", ".gif", ".jfif", ".jpeg", ".jpg", ".jp2", ".pbm", ".pgm", ".png", ".pnm"),
    *(".ppm", ".tga", ".tif", ".tiff", ".webp"),
)
_RESERVED = ("deepmds", "summary")  # the record, and the picture of all faces


def is_photo(path: Path) -> bool:
    """Whether the suffix is that of a photo."""
    return path.suffix.lower() in PHOTO_SUFFIXES


def is_landmark_file(path: Path) -> bool:
    """Whether the suffix is that of a file of landmarks."""
    return path.suffix.lower() in LANDMARK_SUFFIXES


def find_sources(paths: Iterable[str | Path]) -> tuple[list[Path], list[InputError]]:
    """All that is to be read, and what is wrong with the rest: one bad path does not stop others.

    Args:
        paths: Photos and files of landmarks, taken as they are, and folders, of which the photos
            are taken, by name, but neither hidden files nor what lies in folders within.

    Returns:
        Files in the order of the paths, each once; and an error for each path that does not exist,
        each folder without photos, and each file with another suffix.
    """
    sources, errors = {}, []
    for path in map(Path, paths):
        try:
            found = _photos_in(path) if os.path.isdir(path) else [_checked(path)]
        except InputError as error:
            errors.append(error)
        else:
            for source in found:
                sources.setdefault(source.resolve(), source)
    return list(sources.values()), errors


def name_sources(sources: Sequence[Path]) -> list[str]:
    """A name for the results of each source, its stem where that is free.

    Names differ by more than capitals, and none is another with a number behind a hyphen, as
    `name_faces` makes them: of `a.jpg`, `a.png` and `a-1.jpg` come `a`, `a_png` and `a-1_jpg`. None
    is that of a file of the whole run.
    """
    names, taken, numbered = [], {*_RESERVED}, set()

    def clashes(name: str) -> bool:
        return name in taken or name in numbered or _unnumbered(name) in taken

    for source in sources:
        name = source.stem
        if clashes(name.casefold()):
            name = f"{source.stem}_{source.suffix[1:]}"
        again = 2
        while clashes(name.casefold()):
            name = f"{source.stem}_{source.suffix[1:]}_{again}"
            again += 1
        names.append(name)
        taken.add(name.casefold())
        numbered.add(_unnumbered(name.casefold()))
    return names


def name_faces(name: str, n: int) -> list[str]:
    """Names of the n faces of one source: its own, or with numbers from 1 if there are several."""
    if n == 1:
        return [name]
    return [f"{name}-{i:0{len(str(n))}d}" for i in range(1, n + 1)]


def check_folder(folder: Path, sources: Iterable[Path], suffixes: Iterable[str]) -> None:
    """Refuses a folder for results in which one of them could overwrite a source.

    Args:
        folder: Need not exist.
        sources: What is read.
        suffixes: Of the results, such as `".csv"`.

    Raises:
        InputError: It is a file, or a source with one of the suffixes lies in it.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} must be a folder for the results. Received a file.")
    folder, suffixes = folder.resolve(), {*suffixes}
    for source in sources:
        if source.suffix.lower() in suffixes and source.resolve().parent == folder:
            raise InputError(
                f"{folder} must be another folder than that of {source}, which a result could "
                "overwrite. Received the same."
            )


def _photos_in(folder: Path) -> list[Path]:
    try:
        photos = sorted(
            path
            for path in folder.iterdir()
            if is_photo(path) and not path.name.startswith(".") and path.is_file()
        )
    except OSError as error:
        raise InputError(f"{folder} must be a folder that can be read. "
                         f"Received: {error.strerror}.") from None  # fmt: skip
    if not photos:
        raise InputError(
            f"{folder} must hold photos ({', '.join(PHOTO_SUFFIXES)}). Received none; name files "
            "of landmarks one by one."
        )
    return photos


def _checked(path: Path) -> Path:
    if not os.path.exists(path):
        raise InputError(f"{path} does not exist; it must be a photo, a folder of photos or a file "
                         "of landmarks.")  # fmt: skip
    if not (is_photo(path) or is_landmark_file(path)):
        raise InputError(
            f"{path} must be a photo ({', '.join(PHOTO_SUFFIXES)}) or landmarks "
            f"({', '.join(LANDMARK_SUFFIXES)}). Received the suffix {path.suffix!r}."
        )
    return path


def _unnumbered(name: str) -> str | None:
    """`a` of `a-1`; None of a name without a number."""
    match = re.fullmatch(r"(.+)-\d+", name, re.DOTALL)
    return match[1] if match else None
