"""Reads 2D landmarks from the files that other tools, and this one, write."""

from __future__ import annotations

import csv
import json
import os
import re
from pathlib import Path

import numpy as np
import pandas as pd

from deepmds_keras.checks import find_faults
from deepmds_keras.io.archives import map_npy
from deepmds_keras.io.errors import InputError
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.landmarks.conversion import face_sizes, said_sizes

_EMPTY = "NaN or an empty cell"
_FRACTION = 2  # at most, of the width or height of an image; a face may reach beyond it
_TOO_LARGE = 1e9  # no image is, and the squares of far greater numbers overflow
_MAX_BYTES = {".csv": 1 << 29, ".json": 1 << 26, ".npy": 1 << 29, ".pts": 1 << 20}
SUFFIXES = tuple(_MAX_BYTES)
_KEYS = ("faces", "landmarks", "faceLandmarks")  # the last is MediaPipe's in JavaScript
# Columns of one landmark a row; x and y of our own output are those of the 3D shape.
_PAIRS = (("image_x", "image_y"), ("x", "y"))
_COORDINATE = re.compile(r"([xy])_?(\d{1,4})")
_MATLAB_ORIGIN = 0.5  # whose first pixel has its middle at (1, 1), ours at (0.5, 0.5)


def read_landmarks(
    path: str | Path, *, y_up: bool = False, image_size: tuple[float, float] | None = None
) -> np.ndarray:
    """2D landmarks of one or more faces, all with the same L, one of `face_sizes`.

    x and y must be in the same unit, or be fractions of the width and of the height, as MediaPipe's
    are. A third coordinate is ignored.

    - `.npy`: `(L, 2)`, `(n, L, 2)`, `(L, 3)`, `(n, L, 3)`, or x1, y1, x2, … of a face in each row.
    - `.csv`, separated by commas, semicolons, tabs or spaces; lines of comments (`#`) may come
      first. One landmark a row under a header that names the columns `x` and `y` (of our own
      output: `image_x`, `image_y`); of several faces if there is a column `face`; a column `number`
      must count up. Two columns need no header. Or one face a row: columns `x1`, `y1`, … or `x_0`,
      …, `y_0`, … (OpenFace), any others being ignored; without a header x1, y1, x2, ….
    - `.pts` (iBUG 300-W), one face, in MATLAB's pixels: 0.5 is subtracted.
    - `.json`: a list of `[x, y]` or, as MediaPipe has it, of `{"x": …, "y": …}`; a list of such
      faces; `{"landmarks": …}`, `{"faceLandmarks": …}` or `{"faces": [{"landmarks": …}, …]}`, as
      our own output has it.

    A face whose landmarks are all NaN, empty cells or null is a gap. Nothing in the file is
    executed.

    Args:
        path: The file; its suffix tells the format.
        y_up: y grows upwards in the file; it comes back negated.
        image_size: Width and height of the image, of which x and y are fractions in the file.

    Returns:
        `(n, L, 2)` float64, x right, y down, in the unit of the file, or in pixels with
        `image_size`; gaps are NaN.

    Raises:
        InputError: The file is missing, damaged, too large or of no such format; it has another
            number of landmarks or nothing but gaps; a face has text, some NaN or infinity, or is
            one point or one line; x and y are fractions as MediaPipe's are without `image_size`,
            or are none with it.
    """
    points, faults = read_faces(path, y_up=y_up, image_size=image_size)
    for face, fault in faults.items():
        raise InputError(f"{path}, face {face + 1} of {len(points)}, {fault}.")
    return points


@np.errstate(over="ignore", invalid="ignore")  # what is no finite number is refused
def read_faces(
    path: str | Path, *, y_up: bool = False, image_size: tuple[float, float] | None = None
) -> tuple[np.ndarray, dict[int, str]]:
    """`read_landmarks`, with the faces that cannot be used for gaps.

    Returns:
        The landmarks; and for each face that cannot be used, 0-based and ascending, why.

    Raises:
        InputError: As `read_landmarks`, but of faces only if none can be used.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        raise InputError(f"{path} must end in {', '.join(SUFFIXES)}. Received {suffix!r}.")
    try:
        _check_size(path, _MAX_BYTES[suffix])
        points, cells = _READERS[suffix](path)
    except (OSError, MemoryError, csv.Error) as error:
        raise InputError(f"{path} must be a file that can be read. {_line(error)}") from None
    faults = _find_faults(points, cells)
    points[[*faults]] = np.nan
    if np.isnan(points).all():
        if not faults:
            raise InputError(f"{path} must hold landmarks. Received nothing but gaps (NaN).")
        face = min(faults)
        where = f"{path}, face {face + 1} of {len(points)}," if len(points) > 1 else path
        raise InputError(f"{where} {faults[face]}.")
    points = _in_pixels(path, points, image_size)
    if y_up:
        points[..., 1] *= -1
    return points, faults


def _find_faults(points: np.ndarray, cells: dict[int, str]) -> dict[int, str]:
    """Why faces cannot be used: by the cells of a table that are no numbers, and by the numbers."""
    gaps = np.isnan(points).all((1, 2))
    good = (np.abs(points) < _TOO_LARGE).all(2)
    faults = find_faults(np.where(good.all(1)[:, None, None], points, np.nan))
    for face in np.flatnonzero(~good.all(1)).tolist():
        landmark = int(good[face].argmin())
        x, y = points[face, landmark]
        faults[face] = (
            f"must hold finite numbers below {_TOO_LARGE:.0e}. Received ({x:g}, {y:g}) in landmark "
            f"{landmark + 1} of {len(points[face])}"
        )
    faults |= {
        face: f"must have a finite number in each cell of a landmark. Received {cell}"
        for face, cell in cells.items()
    }
    for face in np.flatnonzero(gaps).tolist():
        if cells.get(face, _EMPTY).startswith(_EMPTY):
            del faults[face]
    return faults


def _in_pixels(
    path: Path, points: np.ndarray, image_size: tuple[float, float] | None
) -> np.ndarray:
    """Fractions of the image times its size."""
    largest = np.nanmax(np.abs(points))
    if image_size is not None and largest > _FRACTION:
        raise InputError(
            f"{path} must have fractions of the width and height for --image-size. Received "
            f"coordinates of up to {largest:g}: leave --image-size out."
        )
    if (
        image_size is None
        and largest <= _FRACTION
        and points.shape[1] in load_scheme("mediapipe").sizes
    ):
        raise InputError(
            f"{path} must be in pixels, or --image-size W H be given. Received coordinates of up "
            f"to {largest:.2g}, which seem to be fractions of the image, as MediaPipe has them."
        )
    return points if image_size is None else points * image_size


def _check_size(path: Path, max_bytes: int) -> None:
    if not path.is_file():
        found = "a folder or device" if path.exists() else "a path that does not exist"
        raise InputError(f"{path} must be a file of landmarks. Received {found}.")
    size = path.stat().st_size
    if not 0 < size <= max_bytes:
        found = f"{size:,} bytes" if size else "an empty file"
        most = f"at most {max_bytes >> 20} MiB"
        raise InputError(f"{path} must hold landmarks, in {most}. Received {found}.")


def _read_npy(path: Path) -> tuple[np.ndarray, dict[int, str]]:
    return _as_faces(path, map_npy(path)), {}


def _read_json(path: Path) -> tuple[np.ndarray, dict[int, str]]:
    try:
        content = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} must be JSON. {_line(error)}") from None
    if isinstance(content, dict):
        for key in _KEYS:
            if key in content:
                content = content[key]
                break
        else:
            keys = ", ".join(f'"{key}"' for key in _KEYS)
            raise InputError(f"{path} must have one of the keys {keys}. Received none of them.")
    if isinstance(content, list):
        content = [face.get("landmarks") if isinstance(face, dict) and "x" not in face else face
                   for face in content]  # fmt: skip
        content = [*map(_without_names, content)]
        some = next((face for face in content if face is not None), None)
        if isinstance(some, list) and some and isinstance(some[0], list):  # faces, some are gaps
            gap = [[np.nan] * len(some[0])] * len(some)
            content = [gap if face is None else face for face in content]
    try:
        array = np.asarray(content)
    except (ValueError, OverflowError, RecursionError):
        raise InputError(
            f"{path} must hold [x, y] for each landmark, as many in each face. "
            "Received lists of other lengths."
        ) from None
    return _as_faces(path, array), {}


def _without_names(item):
    """`[x, y]` of a landmark `{"x": …, "y": …}`, or of each of a face; others as they are."""
    if isinstance(item, dict):
        return [item.get("x"), item.get("y")]
    if isinstance(item, list) and item and isinstance(item[0], dict):
        return [*map(_without_names, item)]
    return item


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


def _read_pts(path: Path) -> tuple[np.ndarray, dict[int, str]]:
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
    return np.array([points]) - _MATLAB_ORIGIN, {}


def _read_csv(path: Path) -> tuple[np.ndarray, dict[int, str]]:
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
    table = table[: len(table) - _blank_lines_at_end(path)]
    first_line = skipped + named + 1
    (x, strange), (y, stranger) = (_numbers(table[columns], first_line) for columns in (xs, ys))
    points, strange = np.stack([x, y], axis=-1), stranger | strange
    if len(xs) > 1:
        return points, strange
    columns = {name.lower(): table[[i]] for i, name in enumerate(header)}
    n = _landmarks_per_face(path, columns.get("face"), len(table))
    points = points.reshape(-1, n, 2)
    if "number" in columns:
        numbers = _numbers(columns["number"], first_line)[0].reshape(points.shape[:2])
        if (np.diff(numbers) != 1).any() or np.ptp(numbers[:, 0]):
            raise InputError(
                f"{path} must have landmarks in the order of their numbers, the same in each face. "
                "Received another order in the column number."
            )
    return points, {row // n: strange[row] for row in sorted(strange, reverse=True)}


def _first_row(path: Path) -> tuple[int, str]:
    """Number of comments and empty lines that come first, and the line after them."""
    with open(path, encoding="utf-8-sig", errors="replace") as file:
        for i, line in enumerate(file):
            if "\0" in line:
                raise InputError(f"{path} must be text in UTF-8. Received binary data.")
            if line.strip() and not line.startswith("#"):
                return i, line.rstrip("\r\n")
    raise InputError(f"{path} must hold landmarks. Received no rows.")


def _blank_lines_at_end(path: Path) -> int:
    """Without cells, unlike the rows of gaps that may come before them."""
    with open(path, "rb") as file:
        file.seek(max(file.seek(0, os.SEEK_END) - (1 << 16), 0))
        tail = file.read()
    return max(tail[len(tail.rstrip(b"\r\n")) :].count(b"\n") - 1, 0)


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


def _numbers(table: pd.DataFrame, first_line: int) -> tuple[np.ndarray, dict[int, str]]:
    """The cells, NaN what is no finite number, and what there is instead in each row, if any."""
    numbers = table.apply(pd.to_numeric, errors="coerce").to_numpy(float)
    numbers = np.where(np.isinf(numbers), np.nan, numbers)
    odd = np.isnan(numbers)
    empty = table.isna().to_numpy()
    found = {}
    for row in np.flatnonzero(odd.any(1)).tolist():
        text = odd[row] & ~empty[row]  # sooner said than what is empty
        cell = repr(_short(str(table.iat[row, int(text.argmax())]))) if text.any() else _EMPTY
        found[row] = f"{cell} in line {first_line + row}"
    return numbers, found


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
