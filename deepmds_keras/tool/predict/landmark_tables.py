"""Reads tables (CSV) of landmarks: one landmark per row, or one face per row as OpenFace has it."""

from __future__ import annotations

import codecs
import csv
from array import array
from collections.abc import Collection, Sequence
from itertools import count, groupby, takewhile
from pathlib import Path
from typing import TextIO

import numpy as np

from deepmds_keras.errors import InputError, brief
from deepmds_keras.landmarks import said_sizes

_SEPARATORS = (",", ";", "\t")
_EMPTY = ("", "na", "<na>", "n/a", "#n/a", "nan", "null", "none")  # cells of a gap
_SHOWN = 80  # quoted characters of a file's content


def read_landmark_table(path: Path, *axes: Sequence[str], sizes: Collection[int]) -> np.ndarray:
    """Landmarks of one or more faces, all with the same L.

    Columns `x` and `y` have one landmark per row; several faces need a column `face`, and a column
    `number` must count up. Columns `x_0`, `x_1`, …, `y_0`, … have one face per row. A row whose
    `success` is 0, as OpenFace writes it, is missing, and so is one of this program's without
    `residual`: that landmark was not seen, its place is an estimate. Other columns are not read.

    Cells are separated by commas, or by semicolons or tabs, then perhaps with decimal commas. Text
    is UTF-8, or UTF-16 with its mark. Comments (`#`) may come first.

    Args:
        path: The table.
        axes: Names of the coordinates, such as `("x", "y")`; the first that the table has are read.
        sizes: Numbers of landmarks, of which L must be one.

    Returns:
        `(n, L, d)`, NaN where a cell is empty, infinity where it is text.

    Raises:
        InputError: The file cannot be read, is no such table, or has another number of landmarks.
    """
    try:
        with open(path, encoding=encoding_of(path), errors="replace", newline="") as file:
            first = next((line for line in file if line.strip() and not line.startswith("#")), "")
            points, numbers, faces = _read_rows(path, file, *_layout(path, first, axes), sizes)
    except (OSError, csv.Error) as error:
        received = f"{type(error).__name__}: {brief(error)}"
        raise InputError(f"{path} must be a table of numbers. Received {received}") from None
    if not len(points):
        raise InputError(f"{path} must be a table of numbers. Received no rows.")
    if points.shape[2] > 1:
        check_count(path, points.shape[2], sizes)
        return points.swapaxes(1, 2)
    size = _landmarks_per_face(path, faces, sizes)
    numbers = numbers.reshape(-1, size)
    if (np.diff(numbers) != 1).any() or (numbers[:, 0] != numbers[:1, 0]).any():
        raise InputError(
            f"{path} must have landmarks in the order of their numbers, the same in each face. "
            "Received another order in the column number."
        )
    return points.reshape(-1, size, points.shape[1])


def encoding_of(path: Path) -> str:
    """Name of the encoding of a text file."""
    with open(path, "rb") as file:
        marked = file.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    return "utf-16" if marked else "utf-8-sig"


def check_count(path: Path, n: int, sizes: Collection[int], where: str = "") -> None:
    """Raise InputError unless n is one of the sizes; `where` follows n in the message."""
    if n not in sizes:
        raise InputError(
            f"{path} must have {said_sizes(sizes)} landmarks per face. Received {n}{where}."
        )


def _layout(
    path: Path, first: str, axes: Sequence[Sequence[str]]
) -> tuple[str, list[str], np.ndarray]:
    """Separator, names of the columns in lower case, and which hold the coordinates.

    Of each axis one with one landmark per row, `(d, 1)`; with one face per row L, `(d, L)`.
    """
    for separator in _SEPARATORS:
        cells = next(csv.reader([first], delimiter=separator, skipinitialspace=True), [])
        header = [cell.strip() for cell in cells]
        names = [name.lower() for name in header]
        for coordinates in axes:
            # In the wide layout upper case means something else: OpenFace's X_0 is in millimetres.
            wide = [
                [*takewhile(header.__contains__, (f"{axis}_{i}" for i in count()))]
                for axis in coordinates
            ]
            if {*coordinates} <= {*names}:
                wide, header = [[axis] for axis in coordinates], names
            if not all(wide):
                continue
            used = [*sum(wide, []), "face"]
            if len({*map(len, wide)}) > 1 or max(map(header.count, used)) > 1:
                raise InputError(
                    f"{path} must have equally many columns of each of {', '.join(coordinates)}, "
                    f"each once. Received {brief(first, _SHOWN)!r}."
                )
            columns = np.array([[header.index(name) for name in each] for each in wide])
            return separator, names, columns
    raise InputError(
        f"{path} must have a header with columns {', '.join(axes[-1])}; save numbers without "
        f"one as .npy. Received the first line {brief(first, _SHOWN)!r}."
    )


def _read_rows(
    path: Path,
    file: TextIO,
    separator: str,
    names: list[str],
    columns: np.ndarray,
    sizes: Collection[int],
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Coordinates `(rows, d, 1 or L)`, numbers `(rows,)` of landmarks, and the face of each row."""
    told = [name for name in ("number", "success", "residual") if name in names]
    used = [*columns.ravel().tolist(), *map(names.index, told)]
    face = names.index("face") if "face" in names and columns.shape[1] == 1 else None
    values, end = array("d"), 0
    faces: list[str] = []
    for row in csv.reader(file, delimiter=separator, skipinitialspace=True, strict=True):
        if len(row) < 2 and not any(row):
            continue  # a blank line: Windows may leave one after each row
        if len(row) > len(names):
            raise InputError(
                f"{path} must be a table of {len(names)} cells per row, like the header. "
                f"Received {len(row)} in row {len(faces) + 1}."
            )
        row += [""] * (len(names) - len(row))
        cells = (row[i] for i in used)
        values.extend([_number(c if separator == "," else c.replace(",", ".")) for c in cells])
        faces.append("" if face is None else row[face])
        end = len(faces) if any(row) else end
    if face is not None or len(faces) not in sizes:
        del faces[end:]  # rows of separators alone, which spreadsheets append
    table = np.array(values).reshape(-1, len(used))[: len(faces)]
    points = table[:, : columns.size].reshape(-1, *columns.shape)
    known = dict(zip(told, table[:, columns.size :].T, strict=True))
    if "success" in known:
        points[known["success"] == 0] = np.nan
    if "residual" in known and "image_x" in names:
        points[np.isnan(known["residual"])] = np.nan
    return points, known.get("number", np.empty(0)), faces


def _landmarks_per_face(path: Path, faces: list[str], sizes: Collection[int]) -> int:
    """L of a table with one landmark per row, where a face is a run of one value of `face`."""
    runs = [(face, len([*run])) for face, run in groupby(faces)]
    size = runs[0][1]
    for face, n in runs:
        if n != size:
            raise InputError(
                f"{path} must have the same number of landmarks in each face. Received {size}, "
                f"and {n} for the face {brief(face, _SHOWN)!r}."
            )
    where = "" if any(faces) else " rows, and no column face to tell faces apart"
    check_count(path, size, sizes, where)
    return size


def _number(cell: str) -> float:
    """A cell's number; infinity for text, NaN if it is empty."""
    try:
        return float(cell)
    except ValueError:
        return np.nan if cell.strip().lower() in _EMPTY else np.inf
