"""Photos, videos and files of landmarks that a run reads, and the names of their results."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from deepmds_keras.errors import InputError
from deepmds_keras.predict.landmark_files import SUFFIXES as LANDMARK_SUFFIXES
from deepmds_keras.predict.record import NAME as RECORD

PHOTO_SUFFIXES = (
    *(".avif", ".bmp", ".gif", ".heic", ".heif", ".hif", ".jfif", ".jpeg", ".jpg", ".jp2", ".pbm"),
    *(".pgm", ".png", ".pnm", ".ppm", ".tga", ".tif", ".tiff", ".webp"),
)
VIDEO_SUFFIXES = (".avi", ".mkv", ".mov", ".mp4", ".webm")
_RESERVED = ("deepmds", "summary", "index")  # the record, the picture and the page of all


def is_photo(path: Path) -> bool:
    """Whether the suffix is that of a photo."""
    return path.suffix.lower() in PHOTO_SUFFIXES


def is_video(path: Path) -> bool:
    """Whether the suffix is that of a video."""
    return path.suffix.lower() in VIDEO_SUFFIXES


def is_landmark_file(path: Path) -> bool:
    """Whether the suffix is that of a file of landmarks."""
    return path.suffix.lower() in LANDMARK_SUFFIXES


def find_sources(
    paths: Iterable[str | Path], *, recursive: bool = False
) -> tuple[list[Path], list[InputError], Counter[str]]:
    """All that is to be read, and what is wrong with the rest: one bad path does not stop others.

    Args:
        paths: Photos, videos and files of landmarks, taken as they are, and folders, of which the
            photos are taken, by name, but no hidden files.
        recursive: Take those in folders within too, but for hidden folders, links, and results of
            earlier runs.

    Returns:
        Files in the order of the paths, each once; an error for each path that does not exist,
        each folder without photos, and each file with another suffix; and how many things in
        folders were left out, by what they are.
    """
    sources, errors, skipped = {}, [], Counter()
    for path in map(Path, paths):
        try:
            if os.path.isdir(path):
                found = _photos_in(path, recursive, errors, skipped)
            else:
                found = [_checked(path)]
        except InputError as error:
            errors.append(error)
        else:
            for source in found:
                sources.setdefault(source.resolve(), source)
    return list(sources.values()), errors, skipped


def said_skipped(skipped: Counter[str]) -> str:
    """What `find_sources` left out, as text: `3 .mp4, 2 hidden, 1 subfolder (--recursive)`."""
    return ", ".join(
        f"{n:,} {kind.replace('folder', 'folders') if n > 1 and kind[0] != '.' else kind}"
        for kind, n in skipped.most_common()
    )


def name_sources(sources: Sequence[Path]) -> list[str]:
    """A name for the results of each source, its stem where that is free.

    Names differ by more than capitals, and none is another with a number behind a hyphen, as
    `name_faces` makes them: of `a.jpg`, `a.png` and `a-1.jpg` come `a`, `a_png` and `a-1_jpg`. None
    is that of a file of the whole run.
    """
    names, taken, numbered = [], {*_RESERVED}, set()

    def clashes(name: str) -> bool:
        return (
            name in taken
            or name in numbered
            or _unnumbered(name) in taken
            or name.endswith(".mesh")  # of `a.mesh.jpg`: `a.mesh.ply` is a file of `a.jpg`
        )

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


def _photos_in(
    folder: Path, recursive: bool, errors: list[InputError], skipped: Counter[str]
) -> list[Path]:
    """Photos by name, those of a folder before those within; what cannot be read is appended."""

    def unreadable(error: OSError) -> None:
        errors.append(InputError(f"{error.filename} must be a folder that can be read. "
                                 f"Received: {error.strerror}."))  # fmt: skip

    photos, before = [], len(errors)
    for place, folders, files in os.walk(folder, onerror=unreadable):
        for path in sorted(Path(place, name) for name in files):
            if reason := _why_no_photo(path):
                skipped[reason] += 1
            else:
                photos.append(path)
        within, folders[:] = sorted(folders), []  # os.walk goes on with what is in `folders`
        for name in within:
            if reason := _why_not_within(Path(place, name), recursive):
                skipped[reason] += 1
            else:
                folders.append(name)
    if not photos and len(errors) == before:
        raise InputError(
            f"{folder} must hold photos ({', '.join(PHOTO_SUFFIXES)}). Received none; name videos "
            "and files of landmarks one by one."
        )
    return photos


def _why_no_photo(path: Path) -> str | None:
    if path.name.startswith("."):
        return "hidden"
    if not is_photo(path):
        return path.suffix.lower() or "without suffix"
    return None if path.is_file() else "no file"


def _why_not_within(folder: Path, recursive: bool) -> str | None:
    if folder.name.startswith("."):
        return "hidden"
    if not recursive:
        return "subfolder (--recursive)"
    if folder.is_symlink():  # which may lead back
        return "linked folder"
    return "folder of results" if (folder / RECORD).is_file() else None


def _checked(path: Path) -> Path:
    if not os.path.exists(path):
        raise InputError(f"{path} does not exist; it must be a photo, a folder of photos, a video "
                         "or a file of landmarks.")  # fmt: skip
    if not (is_photo(path) or is_video(path) or is_landmark_file(path)):
        raise InputError(
            f"{path} must be a photo ({', '.join(PHOTO_SUFFIXES)}), a video "
            f"({', '.join(VIDEO_SUFFIXES)}) or landmarks ({', '.join(LANDMARK_SUFFIXES)}). "
            f"Received the suffix {path.suffix!r}."
        )
    return path


def _unnumbered(name: str) -> str | None:
    """`a` of `a-1`; None of a name without a number."""
    match = re.fullmatch(r"(.+)-\d+", name, re.DOTALL)
    return match[1] if match else None
