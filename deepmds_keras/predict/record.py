"""What a folder of results already holds, so that an interrupted run goes on where it stopped."""

from __future__ import annotations

import json
from pathlib import Path

from deepmds_keras import __version__
from deepmds_keras.predict.arguments import Options
from deepmds_keras.predict.writing import write_bytes

_NAME = "deepmds.json"


class Record:
    """Sources whose results lie in a folder, and how they were made.

    A source is done if neither it nor the options have changed since and its files are there.

    Args:
        options: Of the run; the folder is `options.out`.
    """

    def __init__(self, options: Options):
        self._path = options.out / _NAME
        self._options = {
            key: value if isinstance(value, (bool, float, type(None))) else str(value)
            for key, value in vars(options).items()
            if key not in ("sources", "out", "jobs")
        } | {"version": __version__}
        self._done: dict[str, dict] = self._read()

    def is_done(self, source: Path, name: str) -> bool:
        """Whether the results of a source, under that name, need not be made again."""
        entry = self._done.get(str(source.resolve()))
        return (
            entry is not None
            and {**entry, "files": None} == {**self._entry(source, name), "files": None}
            and all((self._path.parent / file).is_file() for file in entry["files"])
        )

    def add(self, source: Path, name: str, files: list[Path]) -> None:
        """Note what a source gave; `save` writes it."""
        entry = self._entry(source, name) | {"files": [file.name for file in files]}
        self._done[str(source.resolve())] = entry

    def save(self) -> None:
        """Write the record, complete or not at all.

        Raises:
            InputError: The folder cannot be written to.
        """
        write_bytes(self._path, (json.dumps(self._done, indent=1) + "\n").encode())

    def _entry(self, source: Path, name: str) -> dict:
        status = source.stat()
        return {
            "name": name,
            "bytes": status.st_size,
            "modified": status.st_mtime_ns,
            "options": self._options,
        }

    def _read(self) -> dict[str, dict]:
        try:
            done = json.loads(self._path.read_text(encoding="utf-8"))
            return {path: entry for path, entry in done.items() if {"files"} <= entry.keys()}
        except (OSError, ValueError, AttributeError):
            return {}  # none, or one that cannot be read: everything is made again
