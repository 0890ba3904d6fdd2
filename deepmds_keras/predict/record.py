"""Record of what a folder of results holds, so that an interrupted run goes on from there."""

from __future__ import annotations

import json
from pathlib import Path

from deepmds_keras import __version__
from deepmds_keras.predict.arguments import Options
from deepmds_keras.predict.writing import write_bytes

NAME = "deepmds.json"
_IRRELEVANT = ("sources", "out", "jobs", "mediapipe_python")  # to what a source gives


class Record:
    """Sources whose results lie in a folder, and how they were made.

    A source is done if neither it nor the options nor the weights have changed since, and its
    files are there.

    Args:
        options: Of the run; the folder is `options.out`.
        weights: Hash of the weights.
    """

    def __init__(self, options: Options, weights: str):
        self.path = options.out / NAME
        relevant = {key: value for key, value in vars(options).items() if key not in _IRRELEVANT}
        self._made = json.loads(json.dumps(relevant | {"version": __version__, "weights": weights}))
        self._begun: dict[Path, dict] = {}
        self._done = self._read()
        self._owner = {file: key for key, entry in self._done.items() for file in entry["files"]}

    def is_done(self, source: Path, name: str) -> bool:
        """Whether the results of a source, under that name, need not be made again.

        What `add` notes of the source is how it is now, though it may change while it is read.
        """
        try:
            status = source.stat()
        except OSError:  # whoever reads it will say so
            return False
        entry = {
            "name": name,
            "bytes": status.st_size,
            "modified": status.st_mtime_ns,
            "made": self._made,
        }
        self._begun[source] = entry
        done = self._done.get(_key(source))
        return (
            done is not None
            and done == entry | {"files": done["files"]}
            and all((self.path.parent / file).is_file() for file in done["files"])
        )

    def add(self, source: Path, files: list[Path]) -> None:
        """Note the files that a source gave; `save` writes it."""
        key, names = _key(source), [file.name for file in files]
        for file in names:
            # A file that was another source's until now: that one's results are here no more.
            if self._owner.get(file, key) != key:
                self._done.pop(self._owner[file], None)
            self._owner[file] = key
        self._done[key] = self._begun[source] | {"files": names}

    def save(self) -> None:
        """Write the record, complete or not at all.

        Raises:
            InputError: The folder cannot be written to.
        """
        write_bytes(self.path, (json.dumps(self._done, indent=1) + "\n").encode())

    def _read(self) -> dict[str, dict]:
        try:
            done = json.loads(self.path.read_bytes())
            whole = {
                key: entry
                for key, entry in done.items()
                if all(isinstance(file, str) for file in entry["files"])
            }
        except (OSError, ValueError, AttributeError, KeyError, TypeError):
            return {}  # none, or one that is damaged: everything is made again
        return whole


def _key(source: Path) -> str:
    return str(source.resolve())
