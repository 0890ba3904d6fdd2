"""Record of what a folder of results holds: a run goes on from it and overwrites nothing else."""

from __future__ import annotations

import json
import os
from pathlib import Path

from deepmds_keras import __version__
from deepmds_keras.errors import InputError
from deepmds_keras.predict.arguments import Options
from deepmds_keras.predict.writing import write_bytes

NAME = "deepmds.json"
# To what a source gives.
_IRRELEVANT = ("sources", "recursive", "out", "force", "jobs")
_NO_SOURCE = ""  # key of files that are of the whole run, or were a source's and are no more


class Record:
    """Sources whose results lie in a folder, and how they were made.

    A source is done if neither it nor the options nor the weights have changed since, and its
    files are there. Every file is claimed before it is written: what lies there and never was is
    somebody else's.

    Args:
        options: Of the run; the folder is `options.out`.
        weights: Hash of the weights.

    Raises:
        InputError: The folder has a file of the record's name that is no record.
    """

    def __init__(self, options: Options, weights: str):
        self.path = options.out / NAME
        relevant = {key: value for key, value in vars(options).items() if key not in _IRRELEVANT}
        self._made = json.loads(json.dumps(relevant | {"version": __version__, "weights": weights}))
        self._begun: dict[Path, dict] = {}
        self._done = self._read()
        self._owner = {file: key for key, entry in self._done.items() for file in entry["files"]}
        self._done.pop(_NO_SOURCE, None)

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

    def claim(self, files: list[Path], source: Path | None = None) -> None:
        """Note the files that a source, or the whole run, is about to give; `save` writes it.

        Raises:
            InputError: One of them is there and was not written by any run.
        """
        for file in files:
            if file.name not in self._owner and os.path.lexists(file):
                raise InputError(
                    f"{file} must not be there yet, or be in the record of the results, {NAME}. "
                    "Received a file that is not: move it away, or name another folder (--out)."
                )
        key, names = _NO_SOURCE if source is None else _key(source), [file.name for file in files]
        # Sources whose files these were until now have no results any more.
        replaced = {key, *(self._owner[name] for name in names if name in self._owner)}
        former = {file for old in replaced for file in self._done.pop(old, {"files": []})["files"]}
        self._owner |= dict.fromkeys(former, _NO_SOURCE) | dict.fromkeys(names, key)
        if source is not None:  # not done before `add`, whatever stops the run
            self._done[key] = {"files": names}

    def add(self, source: Path) -> None:
        """Note that the files of a source, which were claimed, are written; `save` writes it."""
        self._done[_key(source)] |= self._begun[source]

    def results(self) -> list[list[str]]:
        """Names of the files of each source that is done."""
        return [entry["files"] for entry in self._done.values() if "made" in entry]

    def save(self) -> None:
        """Write the record, complete or not at all.

        Raises:
            InputError: The folder cannot be written to.
        """
        held = {file for entry in self._done.values() for file in entry["files"]}
        others = sorted(self._owner.keys() - held)
        content = ({_NO_SOURCE: {"files": others}} if others else {}) | self._done
        write_bytes(self.path, (json.dumps(content, indent=1) + "\n").encode())

    def _read(self) -> dict[str, dict]:
        try:
            done = json.loads(self.path.read_bytes())
            if not all(isinstance(file, str) for entry in done.values() for file in entry["files"]):
                raise TypeError("a file that is no name")
        except (FileNotFoundError, NotADirectoryError):
            return {}
        except (OSError, ValueError, AttributeError, KeyError, TypeError):
            raise InputError(
                f"{self.path} must be the record of earlier results. Received another file, or a "
                "damaged one: move it away, or name another folder (--out)."
            ) from None
        return done


def _key(source: Path) -> str:
    return str(source.resolve())
