"""Reads CSV tables whose comments are lines that begin with `#`."""

from __future__ import annotations

import csv
from pathlib import Path

from deepmds_keras.io.errors import InputError, brief


def read_table(path: Path) -> list[dict[str, str]]:
    """Return the rows, by column name, of a CSV table.

    Raises:
        InputError: The file cannot be read or is no such table.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
        return list(csv.DictReader(line for line in lines if not line.startswith("#")))
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{path} must be a table (CSV). Received {brief(error)}.") from None
