"""Files that stages write: records of what is done, with a checksum, and text."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from deepmds_keras.io.atomic import write_bytes
from deepmds_keras.io.errors import InputError
from experiments.run import Run

_CHECKSUM = "sha256"


def with_checksum(record: dict) -> dict:
    """A record and the checksum of what it says, to be written as JSON."""
    return record | {_CHECKSUM: _checksum(record)}


def read_record(path: Path) -> dict:
    """A record without its checksum. Those of earlier versions have none and are read as they are.

    Raises:
        InputError: The file is missing or damaged.
    """
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        whole = record.pop(_CHECKSUM, None) in (None, _checksum(record))
    except FileNotFoundError:
        raise InputError(f"{path} must be there: the record of what is done.") from None
    except (AttributeError, RecursionError, TypeError, ValueError):
        whole = False
    if not whole:
        raise InputError(
            f"{path} must be a record as it was written. Received another text; delete it and make "
            "it again."
        )
    return record


def load_record(run: Run, name: str) -> dict:
    """Read the record that the stage of that name left.

    Raises:
        InputError: It was not done, or its record is damaged.
    """
    return read_record(run.record_file(name))


def write_json(path: Path, value: dict) -> None:
    write_text(path, json.dumps(value, indent=2, ensure_ascii=False) + "\n")


def write_text(path: Path, text: str) -> None:
    write_bytes(path, text.encode("utf-8"))


def _checksum(record: dict) -> str:
    """sha256 of what a record says, however it is laid out."""
    said = json.loads(json.dumps(record))  # keys are strings in a file
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()
