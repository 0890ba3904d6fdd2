"""The sources of a run, and the names of its results."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain, count
from pathlib import Path

from deepmds_keras.errors import InputError
from deepmds_keras.tool.predict.landmark_files import SUFFIXES as LANDMARK_SUFFIXES

PHOTO_SUFFIXES = (
    *(".avif", ".bmp", ".gif", ".heic", ".heif", ".hif", ".jfif", ".jpeg", ".jpg", ".jp2", ".pbm"),
    *(".pgm", ".png", ".pnm", ".ppm", ".tga", ".tif", ".tiff", ".webp"),
)
VIDEO_SUFFIXES = (".avi", ".mkv", ".mov", ".mp4", ".webm")
LOCK = ".deepmds-lock"  # in every folder of results
_KINDS = {"photo": PHOTO_SUFFIXES, "video": VIDEO_SUFFIXES, "landmarks": LANDMARK_SUFFIXES}


def kind_of(path: Path) -> str | None:
    """`"photo"`, `"video"` or `"landmarks"`, by the suffix."""
    return next((kind for kind, of in _KINDS.items() if path.suffix.lower() in of), None)


def find_sources(
    paths: Iterable[str | Path], *, recursive: bool = False
) -> tuple[list[Path], list[InputError], Counter[str]]:
    """Files to read, and what is wrong with the rest: one bad path does not stop others.

    Args:
        paths: Photos, videos and files of landmarks, and folders, which stand for their photos, by
            name, without hidden files.
        recursive: Whether to include subfolders, except hidden ones, links, and folders of results.

    Returns:
        Files in the order of the paths, each once; an error for each path that does not exist,
        each folder without photos, and each file with another suffix; and the number of entries
        of folders that were skipped, by kind.
    """
    sources: dict[Path, Path] = {}
    errors: list[InputError] = []
    skipped: Counter[str] = Counter()
    for path in paths:
        try:
            if os.path.isdir(path):
                files = _photos_in(Path(path), recursive, errors, skipped)
            else:
                files = [_checked(path)]
        except InputError as error:
            errors.append(error)
        else:
            for source in files:
                sources.setdefault(source.resolve(), source)
    return list(sources.values()), errors, skipped


def list_skipped(skipped: Counter[str]) -> str:
    """What `find_sources` skipped, as text: `3 .mp4, 2 hidden, 1 subfolder (--recursive)`."""
    return ", ".join(
        f"{n:,} {kind.replace('folder', 'folders') if n > 1 and kind[0] != '.' else kind}"
        for kind, n in skipped.most_common()
    )


def name_sources(sources: Sequence[Path], known: Mapping[str, str]) -> list[str]:
    """A name for the results of each source, its stem if that is free.

    Names differ by more than case, and none is another one plus a hyphen and a number, which
    `name_faces` appends: `a.jpg`, `a.png` and `a-1.jpg` give `a`, `a_png` and `a-1_jpg`. None is
    that of a mesh.

    Args:
        sources: Different paths.
        known: Absolute path → the name of its results in the folder. They keep it, so that a new
            `a.jpg` does not take that of an `a.png` that is done.
    """
    names: dict[Path, str] = {}
    used: set[str] = set()
    numbered: set[str] = set()
    before = {source: known.get(str(source.resolve())) for source in sources}
    for source in sorted(sources, key=lambda source: before[source] is None):
        suffixed = f"{source.stem}_{source.suffix[1:]}"
        first = [before[source] or source.stem, source.stem, suffixed]
        for name in chain(first, (f"{suffixed}_{i}" for i in count(2))):
            folded = name.casefold()
            without = re.sub(r"(?<=.)-\d+$", "", folded)
            mesh = folded.endswith(".mesh")  # `a.mesh.ply` is a file of `a.jpg`
            if not ({folded, without} & used or folded in numbered or mesh):
                break
        names[source] = name
        used.add(folded)
        numbered.add(without)
    return [names[source] for source in sources]


def _photos_in(folder: Path, recursive: bool, errors: list, skipped: Counter[str]) -> list[Path]:
    """Photos by name, those of a folder before its subfolders'; appends to errors and skipped."""

    def unreadable(error: OSError) -> None:
        errors.append(InputError(f"{error.filename} cannot be read: {error.strerror}."))

    photos, before = [], len(errors)
    for place, folders, files in os.walk(folder, onerror=unreadable):
        # Files are tested by `os`: Path raises if a folder may be listed but not entered.
        for path in sorted(Path(place, name) for name in files):
            if path.name.startswith("."):
                skipped["hidden"] += 1
            elif kind_of(path) != "photo":
                skipped[path.suffix.lower() or "without suffix"] += 1
            elif not os.path.isfile(path):
                skipped["no file"] += 1
            else:
                photos.append(path)
        within, folders[:] = sorted(folders), []  # os.walk goes on with what is in `folders`
        for path in (Path(place, name) for name in within):
            if path.name.startswith("."):
                skipped["hidden"] += 1
            elif not recursive:
                skipped["subfolder (--recursive)"] += 1
            elif path.is_symlink():  # which may lead back
                skipped["linked folder"] += 1
            elif os.path.isfile(path / LOCK):
                skipped["folder of results"] += 1
            else:
                folders.append(path.name)
    if not photos and len(errors) == before:
        raise InputError(
            f"{folder} must hold photos ({', '.join(PHOTO_SUFFIXES)}). Received none; name videos "
            "and landmark files one by one."
        )
    return photos


def _checked(name: str | Path) -> Path:
    path = Path(name)
    kinds = f"photo ({', '.join(PHOTO_SUFFIXES)}), a folder of photos, a video "
    kinds += f"({', '.join(VIDEO_SUFFIXES)}) or a landmark file ({', '.join(LANDMARK_SUFFIXES)})"
    if not str(name):
        raise InputError(f"a source must be the name of a {kinds}. Received an empty name.")
    if not os.path.exists(path):
        raise InputError(f"{name} does not exist.")
    if kind_of(path) is None:
        raise InputError(f"{path} must be a {kinds}. Received the suffix {path.suffix!r}.")
    if not os.path.isfile(path):  # of a pipe a program would wait for ever
        raise InputError(f"{path} must be a {kinds}. Received a pipe or device.")
    return path
