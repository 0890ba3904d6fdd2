"""Reads CSV tables whose comments are lines that begin with `#`."""

from __future__ import annotations

import csv
from pathlib import Path


def read_table(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    """Comment lines (with their `#`) and rows, by column name, of a CSV table."""
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    comments = [line for line in lines if line.startswith("#")]
    return comments, list(csv.DictReader(line for line in lines if not line.startswith("#")))
