"""Reads 2D landmarks from tables (CSV), a landmark or a face a row."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import TextIO

import numpy as np

from deepmds_keras.errors import InputError, brief
from deepmds_keras.landmarks.conversion import face_sizes, said_sizes

EMPTY = "NaN or an empty cell"  # what a cell of a gap has
_NO_NUMBER = ("", "nan", "na", "n/a", "null", "none")
# Columns of one landmark a row; x and y of our own output are those of the 3D shape.
_PAIRS = (("image_x", "image_y"), ("x", "y"))
_COORDINATE = re.compile(r"([xy])_?(\d{1,4})")
_SHOWN = 80  # letters of what is in a file
_ROWS_AT_ONCE = 1000  # whose cells are in memory as text


def read_csv(path: Path) -> tuple[np.ndarray, dict[int, str]]:
    """The layouts of a table that `read_landmarks` describes.

    Returns:
        `(n, L, 2)` float64, NaN what is no finite number; and for each such face what it has
        instead.

    Raises:
        InputError: It is no such table.
    """
    with _opened(path) as file:
        skipped, first = _first_row(path, file)
    separator = next((s for s in "\t;," if s in first), None)
    header = [cell.strip() for cell in next(_rows([first], separator))]
    named = not all(_is_number(cell) for cell in header if cell)
    xs, ys = _named_columns(path, header) if named else _unnamed_columns(path, len(header))
    # One landmark a row may have a column of faces and one of numbers.
    names = [name.lower() for name in header] if named and len(xs) == 1 else []
    face, number = ([names.index(n)] if n in names else [] for n in ("face", "number"))
    coordinates, faces, strange = _read_rows(
        path, separator, skipped + named, len(header), [*xs, *ys, *number], face
    )
    points = np.stack([coordinates[:, : len(xs)], coordinates[:, len(xs) : 2 * len(xs)]], axis=-1)
    if len(xs) > 1:
        return points, strange
    n = _landmarks_per_face(path, faces, len(points))
    if number:
        numbers = coordinates[:, 2].reshape(-1, n)
        if (np.diff(numbers) != 1).any() or np.ptp(numbers[:, 0]):
            raise InputError(
                f"{path} must have landmarks in the order of their numbers, the same in each face. "
                "Received another order in the column number."
            )
    return points.reshape(-1, n, 2), {row // n: strange[row] for row in sorted(strange)[::-1]}


def _read_rows(
    path: Path,
    separator: str | None,
    skipped: int,
    width: int,
    columns: list[int],
    named: list[int],
) -> tuple[np.ndarray, list[str], dict[int, str]]:
    """Numbers of columns, text of a column, and what rows have that is no finite number.

    Rows without cells are gaps, but at the end of the file there is nothing in them.
    """
    parts, texts, strange, start, n = [], [], {}, 0, 0
    with _opened(path) as file:
        rows = _rows(islice(file, skipped, None), separator)
        while cells := [*islice(rows, _ROWS_AT_ONCE)]:
            for i, row in enumerate(cells, start):
                if len(row) > width:
                    raise InputError(
                        f"{path} must be a table of {width} cells a row, as the first line has. "
                        f"Received {len(row)} in line {skipped + i + 1}."
                    )
                n = i + 1 if row else n
                row += [""] * (width - len(row))
                texts += [row[c] for c in named]
            parts.append(np.array([_numbers([row[c] for c in columns]) for row in cells]))
            for i in np.flatnonzero(~np.isfinite(parts[-1]).all(1)).tolist():
                cell = _first_strange([cells[i][c] for c in columns])
                strange[start + i] = f"{cell} in line {skipped + start + i + 1}"
            start += len(cells)
    if not n:
        raise InputError(f"{path} must be a table of numbers. Received no rows.")
    numbers = np.concatenate(parts)[:n]
    strange = {row: cell for row, cell in strange.items() if row < n}
    return np.where(np.isfinite(numbers), numbers, np.nan), texts[:n], strange


def _opened(path: Path) -> TextIO:
    return open(path, encoding="utf-8-sig", errors="replace", newline="")


def _rows(lines: Iterable[str], separator: str | None) -> Iterator[list[str]]:
    if separator is None:
        # An empty line has no cell, one of spaces an empty one, as in the other tables.
        return ((line.split() or [""]) if line.strip("\r\n") else [] for line in lines)
    return csv.reader(lines, delimiter=separator, skipinitialspace=True, strict=True)


def _numbers(cells: list[str]) -> np.ndarray:
    """NaN what is no number."""
    try:
        return np.array(cells, float)
    except ValueError:
        return np.array([float(cell) if _is_number(cell) else np.nan for cell in cells])


def _first_strange(cells: list[str]) -> str:
    """A cell of a row that is no finite number; what is empty only if all such are."""
    odd = [cell for cell in cells if not _is_number(cell) or not np.isfinite(float(cell))]
    text = [cell for cell in odd if cell.strip().lower() not in _NO_NUMBER]
    return repr(brief(text[0], _SHOWN)) if text else EMPTY


def _first_row(path: Path, lines: Iterable[str]) -> tuple[int, str]:
    """Number of comments and empty lines that come first, and the line after them."""
    for i, line in enumerate(lines):
        if "\0" in line:
            raise InputError(f"{path} must be text in UTF-8. Received binary data.")
        if line.strip() and not line.startswith("#"):
            return i, line.rstrip("\r\n")
    raise InputError(f"{path} must hold landmarks. Received no rows.")


def _unnamed_columns(path: Path, n: int) -> tuple[list[int], list[int]]:
    """Columns of the x and of the y: one each, or one for each landmark of a face."""
    if n not in (2, *row_lengths()):
        raise InputError(
            f"{path} must have 2 columns, 2 for each of {said_sizes()} landmarks, or a header that "
            f"names x and y. Received {n} columns without a header."
        )
    return [*range(0, n, 2)], [*range(1, n, 2)]


def _named_columns(path: Path, header: list[str]) -> tuple[list[int], list[int]]:
    """As `_unnamed_columns`."""
    # As written first: OpenFace has x_0 in pixels and X_0 in millimetres.
    for names in (header, [name.lower() for name in header]):
        for x, y in _PAIRS:
            if x in names and y in names:
                return [names.index(x)], [names.index(y)]
        matches = {i: _COORDINATE.fullmatch(name) for i, name in enumerate(names)}
        found = {(match[1], int(match[2])): i for i, match in matches.items() if match}
        xs, ys = (sorted(n for axis, n in found if axis == a) for a in "xy")
        if xs and xs == ys:
            check_count(path, len(xs))
            return [found["x", n] for n in xs], [found["y", n] for n in ys]
    raise InputError(
        f"{path} must have columns x and y, or x1, y1, x2, …. "
        f"Received the first line {brief(', '.join(header), _SHOWN)!r}."
    )


def _landmarks_per_face(path: Path, faces: list[str], n_rows: int) -> int:
    """L of a table of one landmark a row, whose faces are runs of the same value."""
    if not faces:
        check_count(path, n_rows, " rows, and no column face that tells several apart")
        return n_rows
    starts = [0, *(i for i in range(1, n_rows) if faces[i] != faces[i - 1])]
    counts = np.diff([*starts, n_rows]).tolist()
    for start, count in zip(starts, counts, strict=True):
        if count != counts[0]:
            raise InputError(
                f"{path} must have the same number of landmarks in each face. Received "
                f"{counts[0]}, and {count} for the face {brief(faces[start], _SHOWN)!r}."
            )
    check_count(path, counts[0])
    return counts[0]


def check_count(path: Path, n: int, where: str = "") -> None:
    """Check the number of landmarks of a face.

    Raises:
        InputError: No scheme has as many.
    """
    if n not in face_sizes():
        raise InputError(f"{path} must have {said_sizes()} landmarks a face. Received {n}{where}.")


def row_lengths() -> tuple[int, ...]:
    """Coordinates of a face in one row."""
    return tuple(2 * n for n in face_sizes())


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
