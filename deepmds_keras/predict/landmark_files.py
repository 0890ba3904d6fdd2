"""Reads 2D landmarks from the files that other tools, and this one, write."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pandas as pd

from deepmds_keras.checks import check_points
from deepmds_keras.io.archives import map_npy
from deepmds_keras.io.errors import InputError
from deepmds_keras.landmarks.conversion import face_sizes, said_sizes

_TOO_LARGE = 1e9  # no image is, and the squares of far greater numbers overflow
_MAX_BYTES = {".csv": 1 << 29, ".json": 1 << 26, ".npy": 1 << 29, ".pts": 1 << 20}
SUFFIXES = tuple(_MAX_BYTES)
# Columns of one landmark a row; x and y of our own output are those of the 3D shape.
_PAIRS = (("image_x", "image_y"), ("x", "y"))
_COORDINATE = re.compile(r"([xy])_?(\d{1,4})")
_MATLAB_ORIGIN = 0.5  # whose first pixel has its middle at (1, 1), ours at (0.5, 0.5)


@np.errstate(over="ignore", invalid="ignore")  # what is no finite number is refused
def read_landmarks(path: str | Path, *, y_up: bool = False) -> np.ndarray:
    """2D landmarks of one or more faces, all with the same L, one of `face_sizes`.

    x and y must be in the same unit: MediaPipe's, which are fractions of the width and of the
    height, must be multiplied by these before they are written. A third coordinate is ignored.

    - `.npy`: `(L, 2)`, `(n, L, 2)`, `(L, 3)`, `(n, L, 3)`, or x1, y1, x2, … of a face in each row.
    - `.csv`, separated by commas, semicolons, tabs or spaces; lines of comments (`#`) may come
      first. One landmark a row under a header that names the columns `x` and `y` (of our own
      output: `image_x`, `image_y`); of several faces if there is a column `face`; a column `number`
      must count up. Two columns need no header. Or one face a row: columns `x1`, `y1`, … or `x_0`,
      …, `y_0`, … (OpenFace), any others being ignored; without a header x1, y1, x2, ….
    - `.pts` (iBUG 300-W), one face, in MATLAB's pixels: 0.5 is subtracted.
    - `.json`: a list of `[x, y]`, a list of faces, `{"landmarks": …}`, or
      `{"faces": [{"landmarks": …}, …]}`, as our own output has it.

    Nothing in the file is executed.

    Args:
        path: The file; its suffix tells the format.
        y_up: y grows upwards in the file; it comes back negated.

    Returns:
        `(n, L, 2)` float64, x right, y down, in the unit of the file.

    Raises:
        InputError: The file is missing, damaged, too large or of no such format; it has another
            number of landmarks, text, NaN or infinity; a face is one point or one line.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        raise InputError(f"{path} must end in {', '.join(SUFFIXES)}. Received {suffix!r}.")
    try:
        _check_size(path, _MAX_BYTES[suffix])
        points = _READERS[suffix](path)
    except (OSError, MemoryError, csv.Error) as error:
        raise InputError(f"{path} must be a file that can be read. {_line(error)}") from None
    for face, landmark in np.argwhere(~(np.abs(points) < _TOO_LARGE).all(-1))[:1]:
        x, y = points[face, landmark]
        raise InputError(
            f"{path} must hold finite numbers below {_TOO_LARGE:.0e}. "
            f"Received ({x:g}, {y:g}) in face {face}, landmark {landmark}, counted from 0."
        )
    if y_up:
        points[..., 1] *= -1
    return check_points(points, str(path), 2)


def _check_size(path: Path, max_bytes: int) -> None:
    if not path.is_file():
        found = "a folder or device" if path.exists() else "a path that does not exist"
        raise InputError(f"{path} must be a file of landmarks. Received {found}.")
    size = path.stat().st_size
    if not 0 < size <= max_bytes:
        found = f"{size:,} bytes" if size else "an empty file"
        most = f"at most {max_bytes >> 20} MiB"
        raise InputError(f"{path} must hold landmarks, in {most}. Received {found}.")


def _read_npy(path: Path) -> np.ndarray:
    return _as_faces(path, map_npy(path))


def _read_json(path: Path) -> np.ndarray:
    try:
        content = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} must be JSON. {_line(error)}") from None
    faces = content.get("faces") if isinstance(content, dict) else None
    if isinstance(faces, list):
        content = [face.get("landmarks") if isinstance(face, dict) else face for face in faces]
    elif isinstance(content, dict):
        if "landmarks" not in content:
            raise InputError(f'{path} must have a key "landmarks" or "faces". Received neither.')
        content = content["landmarks"]
    try:
        array = np.asarray(content)
    except (ValueError, OverflowError, RecursionError):
        raise InputError(
            f"{path} must hold [x, y] for each landmark, as many in each face. "
            "Received lists of other lengths."
        ) from None
    return _as_faces(path, array)


def _as_faces(path: Path, array: np.ndarray) -> np.ndarray:
    """`(n, L, 2)` float64, of any of the layouts of an array."""
    if array.dtype.kind not in "iuf":
        kind = "text, null or objects" if array.dtype.kind in "OUS" else f"dtype {array.dtype}"
        raise InputError(f"{path} must hold numbers only for its landmarks. Received {kind}.")
    shape = array.shape
    if shape[-1:] in ((2,), (3,)) and len(shape) in (2, 3):
        _check_count(path, shape[-2])
        faces = array.reshape(-1, *shape[-2:])[..., :2]
    elif len(shape) in (1, 2) and shape[-1] in _row_lengths():
        faces = array.reshape(-1, shape[-1] // 2, 2)
    else:
        raise InputError(
            f"{path} must have shape (landmarks, 2), (faces, landmarks, 2) or (faces, 2 x "
            f"landmarks), with {said_sizes()} landmarks. Received {shape}."
        )
    if not len(faces):
        raise InputError(f"{path} must hold at least one face. Received none.")
    return np.array(faces, float)


def _read_pts(path: Path) -> np.ndarray:
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    lines = [line.strip() for line in text.splitlines()]
    if "{" not in lines or "}" not in lines:
        raise InputError(
            f"{path} must have its landmarks between lines of {{ and }}. "
            "Received no such lines: it is cut short, or no 300-W file."
        )
    first, last = lines.index("{") + 1, lines.index("}")
    points = []
    for i, line in enumerate(lines[first:last], first + 1):
        try:
            if line:
                x, y = map(float, line.split())
                points.append((x, y))
        except ValueError:
            raise InputError(
                f"{path} must have two numbers per landmark. Received {_short(line)!r} in line {i}."
            ) from None
    _check_count(path, len(points))
    return np.array([points]) - _MATLAB_ORIGIN


def _read_csv(path: Path) -> np.ndarray:
    skipped, first = _first_row(path)
    separator = next((s for s in "\t;," if s in first), None)
    header = next(csv.reader([first], delimiter=separator)) if separator else first.split()
    header = [cell.strip() for cell in header]
    named = not all(_is_number(cell) for cell in header if cell)
    xs, ys = _named_columns(path, header) if named else _unnamed_columns(path, len(header))
    try:
        table = pd.read_csv(
            path,
            sep=separator or r"\s+",
            header=None,
            skiprows=skipped + named,
            skip_blank_lines=False,  # the lines of a message are those of the file
            skipinitialspace=True,
            encoding="utf-8-sig",
            encoding_errors="replace",
            low_memory=False,
        )
    except (ValueError, OverflowError) as error:  # pandas' own errors are among these
        raise InputError(f"{path} must be a table of numbers. {_line(error)}") from None
    filled = np.flatnonzero(table.notna().any(axis=1))
    if not len(filled) or table.shape[1] != len(header):
        raise InputError(
            f"{path} must have rows of {len(header)} cells, as the first line has. "
            f"Received {f'{table.shape[1]} cells' if len(filled) else 'none'}."
        )
    table = table[: filled[-1] + 1]
    first_line = skipped + named + 1
    x, y = (_numbers(path, table[columns], first_line) for columns in (xs, ys))
    points = np.stack([x, y], axis=-1)
    if len(xs) > 1:
        return points
    columns = {name.lower(): table[[i]] for i, name in enumerate(header)}
    points = points.reshape(-1, _landmarks_per_face(path, columns.get("face"), len(table)), 2)
    if "number" in columns:
        numbers = _numbers(path, columns["number"], first_line).reshape(points.shape[:2])
        if (np.diff(numbers) != 1).any() or np.ptp(numbers[:, 0]):
            raise InputError(
                f"{path} must have landmarks in the order of their numbers, the same in each face. "
                "Received another order in the column number."
            )
    return points


def _first_row(path: Path) -> tuple[int, str]:
    """Number of comments and empty lines that come first, and the line after them."""
    with open(path, encoding="utf-8-sig", errors="replace") as file:
        for i, line in enumerate(file):
            if "\0" in line:
                raise InputError(f"{path} must be text in UTF-8. Received binary data.")
            if line.strip() and not line.startswith("#"):
                return i, line.rstrip("\r\n")
    raise InputError(f"{path} must hold landmarks. Received no rows.")


def _unnamed_columns(path: Path, n: int) -> tuple[list[int], list[int]]:
    """Columns of the x and of the y: one each, or one for each landmark of a face."""
    if n not in (2, *_row_lengths()):
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
            _check_count(path, len(xs))
            return [found["x", n] for n in xs], [found["y", n] for n in ys]
    raise InputError(
        f"{path} must have columns x and y, or x1, y1, x2, …. "
        f"Received the first line {_short(', '.join(header))!r}."
    )


def _landmarks_per_face(path: Path, face: pd.DataFrame | None, n_rows: int) -> int:
    """L of a table of one landmark a row, whose faces are runs of the same value."""
    if face is None:
        _check_count(path, n_rows, " rows, and no column face that tells several apart")
        return n_rows
    starts = np.append(0, np.flatnonzero(np.diff(pd.factorize(face.iloc[:, 0])[0])) + 1)
    counts = np.diff(np.append(starts, n_rows))
    for i in np.flatnonzero(counts != counts[0])[:1]:
        raise InputError(
            f"{path} must have the same number of landmarks in each face. Received {counts[0]}, "
            f"and {counts[i]} for the face {_short(str(face.iat[starts[i], 0]))!r}."
        )
    _check_count(path, counts[0])
    return int(counts[0])


def _numbers(path: Path, table: pd.DataFrame, first_line: int) -> np.ndarray:
    numbers = table.apply(pd.to_numeric, errors="coerce").to_numpy(float)
    for row, column in np.argwhere(~np.isfinite(numbers))[:1]:
        cell = table.iat[row, column]
        found = "NaN or an empty cell" if pd.isna(cell) else repr(_short(str(cell)))
        raise InputError(
            f"{path} must have a finite number in each cell of a landmark. "
            f"Received {found} in line {first_line + row}."
        )
    return numbers


def _check_count(path: Path, n: int, where: str = "") -> None:
    if n not in face_sizes():
        raise InputError(f"{path} must have {said_sizes()} landmarks a face. Received {n}{where}.")


def _row_lengths() -> tuple[int, ...]:
    """Coordinates of a face in one row."""
    return tuple(2 * n for n in face_sizes())


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _short(text: str) -> str:
    return " ".join(text.split())[:80]


def _line(error: Exception) -> str:
    return f"Received {type(error).__name__}: {_short(str(error))}"


_READERS = {".csv": _read_csv, ".json": _read_json, ".npy": _read_npy, ".pts": _read_pts}
