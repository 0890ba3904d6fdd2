"""What a run reads, the names of its results, and the record of what it has written."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections import Counter
from collections.abc import Container, Iterable, Sequence
from itertools import chain, count
from pathlib import Path

from deepmds_keras import __version__
from deepmds_keras.errors import InputError
from deepmds_keras.files import write_bytes
from deepmds_keras.predict.landmark_files import SUFFIXES as LANDMARK_SUFFIXES

PHOTO_SUFFIXES = (
    *(".avif", ".bmp", ".gif", ".heic", ".heif", ".hif", ".jfif", ".jpeg", ".jpg", ".jp2", ".pbm"),
    *(".pgm", ".png", ".pnm", ".ppm", ".tga", ".tif", ".tiff", ".webp"),
)
VIDEO_SUFFIXES = (".avi", ".mkv", ".mov", ".mp4", ".webm")
RECORD = "deepmds.json"  # of a folder of results


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
    paths: Iterable[str | Path], *, recursive: bool = False, results: Container[Path] = ()
) -> tuple[list[Path], list[InputError], Counter[str]]:
    """All that is to be read, and what is wrong with the rest: one bad path does not stop others.

    Args:
        paths: Photos, videos and files of landmarks, taken as they are, and folders, of which the
            photos are taken, by name, but no hidden files.
        recursive: Take those in subfolders too, but for hidden folders, links, and results of
            earlier runs.
        results: Files that earlier runs wrote, which are not taken from folders.

    Returns:
        Files in the order of the paths, each once; an error for each path that does not exist,
        each folder without photos, and each file with another suffix; and how many things in
        folders were left out, by what they are.
    """
    sources, errors, skipped = {}, [], Counter()
    for path in paths:
        try:
            if os.path.isdir(path):
                found = _photos_in(Path(path), recursive, results, errors, skipped)
            else:
                found = [_checked(path)]
        except InputError as error:
            errors.append(error)
        else:
            for source in found:
                sources.setdefault(source.resolve(), source)
    return list(sources.values()), errors, skipped


def list_skipped(skipped: Counter[str]) -> str:
    """What `find_sources` left out, as text: `3 .mp4, 2 hidden, 1 subfolder (--recursive)`."""
    return ", ".join(
        f"{n:,} {kind.replace('folder', 'folders') if n > 1 and kind[0] != '.' else kind}"
        for kind, n in skipped.most_common()
    )


def name_sources(sources: Sequence[Path]) -> list[str]:
    """A name for the results of each source, its stem where that is free.

    Names differ by more than capitals, and none is another with a number behind a hyphen, as
    `name_faces` makes them: of `a.jpg`, `a.png` and `a-1.jpg` come `a`, `a_png` and `a-1_jpg`. None
    is that of the record of a folder, or of a mesh.
    """
    names, used, numbered = [], {Path(RECORD).stem}, set()
    for source in sources:
        suffixed = f"{source.stem}_{source.suffix[1:]}"
        for name in chain([source.stem, suffixed], (f"{suffixed}_{i}" for i in count(2))):
            folded = name.casefold()
            without = re.sub(r"(?<=.)-\d+$", "", folded)
            mesh = folded.endswith(".mesh")  # `a.mesh.ply` is a file of `a.jpg`
            if not ({folded, without} & used or folded in numbered or mesh):
                break
        names.append(name)
        used.add(folded)
        numbered.add(without)
    return names


def name_faces(name: str, n: int) -> list[str]:
    """Names of the n faces of one source: its own, or with numbers from 1 if there are several."""
    if n == 1:
        return [name]
    return [f"{name}-{i:0{len(str(n))}d}" for i in range(1, n + 1)]


class Record:
    """The file `deepmds.json` of a folder: sources whose results lie there, and all files written.

    A source is done if neither it nor the settings nor the weights have changed since, and its
    files are there. The record grows by a line for each source.

    Args:
        folder: Of the results; need not exist.
        settings: That results depend on.

    Raises:
        InputError: The folder has a file of the record's name that is no record.
    """

    def __init__(self, folder: Path, settings: dict):
        text = json.dumps(settings | {"version": __version__}, sort_keys=True, default=str)
        self._settings = hashlib.sha256(text.encode()).hexdigest()[:16]
        self.path, self._folder = folder / RECORD, folder.resolve()
        self._done: dict[str, dict] = {}  # by the path of the source
        self._owners: dict[str, str] = {}  # of every file that a run wrote, by its name
        self._status: dict[Path, dict] = {}
        self._read()

    def __contains__(self, path: Path) -> bool:
        """Whether a run wrote this file."""
        return path.name in self._owners and path.parent.resolve() == self._folder

    def is_done(self, source: Path, name: str) -> bool:
        """Whether the results of a source, under that name, need not be made again.

        What `add` notes of the source is how it is now, though it may change while it is read.
        """
        status = source.stat()
        self._status[source] = {"bytes": status.st_size, "modified": status.st_mtime_ns}
        done = self._done.get(str(source.resolve()))
        return (
            done is not None
            and done == self._entry(source, name, done["files"])
            and all((self._folder / file).is_file() for file in done["files"])
        )

    def why_not(self, path: Path, overwrite: bool, sources: Container[Path]) -> str | None:
        """Why a file must not be written: there is a source, or something that no run wrote."""
        if path.resolve() in sources:
            return f"{path} is a source: name another folder for the results (--out)."
        if path.is_dir() or (os.path.lexists(path) and path not in self and not overwrite):
            return (
                f"{path} must not be there yet, or be in the record of the results, {RECORD}. "
                "Received what no run wrote: move it away, name another folder (--out), or replace "
                "it by --overwrite."
            )
        return None

    def begin(self) -> None:
        """Read the record again, which another run may have written to, and write it compactly."""
        self._read()
        former = [file for file, owner in self._owners.items() if not owner]
        entries = [*self._done.values(), *([{"source": "", "files": former}] if former else [])]
        lines = ",\n".join(map(json.dumps, entries))
        write_bytes(self.path, f"[\n{lines}\n]\n".encode())

    def add(self, source: Path, name: str, files: list[str]) -> None:
        """Note the files that a source gives, which need not be there yet."""
        entry = self._entry(source, name, files)
        separator = ",\n" if self._done or self._owners else ""
        with open(self.path, "r+b") as file:
            file.seek(-len(b"\n]\n"), os.SEEK_END)
            file.write(f"{separator}{json.dumps(entry)}\n]\n".encode())
        self._note(entry)

    def _read(self) -> None:
        try:
            first, *lines = self.path.read_text(encoding="utf-8").splitlines()
            if first != "[":
                raise ValueError("no list")
            for i, line in enumerate(lines):
                # The last line may be cut short.
                if line.startswith("{") and (line.endswith("}") or i < len(lines) - 1):
                    self._note(json.loads(line.removesuffix(",")))
        except (FileNotFoundError, NotADirectoryError):
            pass
        except (OSError, ValueError, KeyError, TypeError):
            raise InputError(
                f"{self.path} must be the record of earlier results. Received another file, or a "
                "damaged one: move it away, or name another folder (--out)."
            ) from None

    def _entry(self, source: Path, name: str, files: list[str]) -> dict:
        entry = {"source": str(source.resolve()), "name": name, "files": files}
        return entry | self._status[source] | {"settings": self._settings}

    def _note(self, entry: dict) -> None:
        # Sources whose files these were until now have no results any more.
        for key in {entry["source"], *(self._owners.get(file, "") for file in entry["files"])}:
            former = self._done.pop(key, {"files": []})["files"]
            self._owners |= dict.fromkeys(former, "")
        self._owners |= dict.fromkeys(entry["files"], entry["source"])
        if entry["source"]:
            self._done[entry["source"]] = entry


def _photos_in(
    folder: Path, recursive: bool, results: Container[Path], errors: list, skipped: Counter[str]
) -> list[Path]:
    """Photos by name, those of a folder before those within; what cannot be read is appended."""

    def unreadable(error: OSError) -> None:
        errors.append(InputError(f"{error.filename} must be a folder that can be read. "
                                 f"Received: {error.strerror}."))  # fmt: skip

    photos, before = [], len(errors)
    for place, folders, files in os.walk(folder, onerror=unreadable):
        # Files are looked at by `os`: Path raises where a folder may be listed but not entered.
        for path in sorted(Path(place, name) for name in files):
            if path.name.startswith("."):
                skipped["hidden"] += 1
            elif not is_photo(path):
                skipped[path.suffix.lower() or "without suffix"] += 1
            elif not os.path.isfile(path):
                skipped["no file"] += 1
            elif path in results:
                skipped["result of an earlier run"] += 1
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
            elif os.path.isfile(path / RECORD):
                skipped["folder of results"] += 1
            else:
                folders.append(path.name)
    if not photos and len(errors) == before:
        raise InputError(
            f"{folder} must hold photos ({', '.join(PHOTO_SUFFIXES)}). Received none; name videos "
            "and files of landmarks one by one."
        )
    return photos


def _checked(name: str | Path) -> Path:
    path = Path(name)
    kinds = f"photo ({', '.join(PHOTO_SUFFIXES)}), a folder of photos, a video "
    kinds += (
        f"({', '.join(VIDEO_SUFFIXES)}) or a file of landmarks ({', '.join(LANDMARK_SUFFIXES)})"
    )
    if not str(name):
        raise InputError(f"a source must be the name of a {kinds}. Received an empty name.")
    if not os.path.exists(path):
        raise InputError(f"{path} does not exist; it must be a {kinds}.")
    if not (is_photo(path) or is_video(path) or is_landmark_file(path)):
        raise InputError(f"{path} must be a {kinds}. Received the suffix {path.suffix!r}.")
    if not os.path.isfile(path):  # of a pipe a program would wait for ever
        raise InputError(f"{path} must be a {kinds}. Received a pipe or device.")
    return path
