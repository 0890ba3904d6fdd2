"""Reads 2D landmarks from files: NPY, PTS, tables and JSON of this program, MediaPipe's JSON."""

from __future__ import annotations

import csv
import json
import re
from array import array
from itertools import chain, groupby
from pathlib import Path

import numpy as np

from deepmds_keras.errors import InputError, brief
from deepmds_keras.files import map_npy
from deepmds_keras.landmarks import face_sizes, load_scheme, said_sizes
from deepmds_keras.lifting.inputs import LEAST_VISIBLE
from deepmds_keras.validation import find_faults

_FRACTION = 2  # largest fraction of the width or height of an image; a face may reach beyond it
_TOO_LARGE = 1e9  # for any image; squares of far larger numbers overflow
_MAX_BYTES = {".csv": 1 << 29, ".json": 1 << 26, ".npy": 1 << 29, ".pts": 1 << 20}
SUFFIXES = tuple(_MAX_BYTES)
_KEYS = ("faces", "landmarks", "faceLandmarks")  # the last is MediaPipe's in JavaScript
_MATLAB_ORIGIN = 0.5  # MATLAB's first pixel has its middle at (1, 1), ours at (0.5, 0.5)
# Columns with one landmark per row; x and y in our own output are those of the 3D shape.
_PAIRS = (("image_x", "image_y"), ("x", "y"))
_EMPTY = ("", "nan", "null", "none")  # cells of a gap
_SHOWN = 80  # quoted characters of a file's content


def read_landmarks(
    path: str | Path,
    *,
    y_up: bool = False,
    image_size: tuple[float, float] | None = None,
    scheme: str | Path | None = None,
) -> np.ndarray:
    """Read 2D landmarks of one or more faces, or other objects, all with the same L.

    x and y must be in the same unit, or fractions of the width and of the height, as MediaPipe
    gives them. A third coordinate is ignored.

    - `.npy`: `(L, 2)`, `(n, L, 2)`, `(L, 3)` or `(n, L, 3)`.
    - `.csv`, with commas and a header; comments (`#`) may come first. One landmark per row:
      columns `image_x` and `image_y`, as `deepmds predict` writes them, or `x` and `y`; several
      faces need a column `face`; a column `number` must count up. Other columns are ignored.
    - `.pts` (iBUG 300-W), one face, in MATLAB's pixels: 0.5 is subtracted.
    - `.json`: a list of `[x, y]` or, like MediaPipe's, of `{"x": …, "y": …}`; a list of such
      faces; `{"landmarks": …}`, `{"faceLandmarks": …}` or `{"faces": [{"landmarks": …}, …]}`, as
      `deepmds predict` writes it.

    NaN, empty cells and null are missing landmarks; a face without any landmark is a gap. Nothing
    in the file is executed.

    Args:
        path: The file; its suffix gives the format.
        y_up: Whether y grows upwards in the file; it is returned negated.
        image_size: Width and height of the image if x and y are fractions of them.
        scheme: Scheme of the landmarks, as for `load_scheme`; None is any of a face, told by L.

    Returns:
        `(n, L, 2)` float64, x right, y down, in the unit of the file, or in pixels with
        `image_size`; NaN where a landmark is missing.

    Raises:
        InputError: The file is missing, damaged, too large or in another format; it has another
            number of landmarks or nothing but gaps; a face has text, infinity or fewer than six
            landmarks, or is one point or one line; x and y seem to be fractions and there is no
            `image_size`, or the reverse.
    """
    points, faults = read_faces(path, y_up=y_up, image_size=image_size, scheme=scheme)
    for face, fault in faults.items():
        raise InputError(f"{path}, face {face + 1} of {len(points)}, {fault}.")
    return points


@np.errstate(over="ignore", invalid="ignore")  # numbers that are not finite are refused
def read_faces(
    path: str | Path,
    *,
    y_up: bool = False,
    image_size: tuple[float, float] | None = None,
    scheme: str | Path | None = None,
) -> tuple[np.ndarray, dict[int, str]]:
    """`read_landmarks`, with unusable faces turned into gaps.

    Returns:
        The landmarks; and the number of each unusable face, 0-based and ascending, → the reason.

    Raises:
        InputError: As for `read_landmarks`, but for faces only if none can be used.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        raise InputError(f"{path} must end in {', '.join(SUFFIXES)}. Received {suffix!r}.")
    sizes = face_sizes() if scheme is None else load_scheme(scheme).sizes
    try:
        _check_size(path, _MAX_BYTES[suffix])
        points = _READERS[suffix](path, sizes)
    except (OSError, MemoryError, RecursionError) as error:
        raise InputError(f"{path} must be a file that can be read. {_received(error)}") from None
    points[np.isnan(points).any(2)] = np.nan  # half a landmark is none
    faults = _find_faults(points)
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


def find_unusable(points: np.ndarray) -> dict[int, str]:
    """Faces `(n, L, 2)` from which no shape can be estimated; NaN are missing landmarks.

    Returns:
        Number of the face, 0-based and ascending, → the reason. Gaps, faces without any landmark,
        are not among them.
    """
    missing = np.isnan(points).any(2, keepdims=True)
    counts = (~missing).sum((1, 2))
    # Missing landmarks are replaced by the middle, which keeps a line a line.
    middles = np.where(missing, 0, points).sum(1) / np.maximum(counts, 1)[:, None]
    faults = find_faults(np.where(missing, middles[:, None], points))
    for face in np.flatnonzero(counts < LEAST_VISIBLE).tolist():
        faults[face] = f"must have at least {LEAST_VISIBLE} landmarks. Received {counts[face]}"
    return {face: faults[face] for face in sorted(faults) if counts[face]}


def _find_faults(points: np.ndarray) -> dict[int, str]:
    """`find_unusable`, and faces with numbers that cannot be image coordinates."""
    bad = (np.abs(points) >= _TOO_LARGE).any(2)  # False for NaN
    faults = find_unusable(np.where(bad[..., None], 0, points))
    for face in np.flatnonzero(bad.any(1)).tolist():
        landmark = int(bad[face].argmax())
        x, y = points[face, landmark]
        received = "text or infinity" if np.isinf([x, y]).any() else f"({x:g}, {y:g})"
        faults[face] = (
            f"must have finite numbers below {_TOO_LARGE:.0e} for each landmark. Received "
            f"{received} in landmark {landmark + 1} of {len(points[face])}"
        )
    return dict(sorted(faults.items()))


def _in_pixels(
    path: Path, points: np.ndarray, image_size: tuple[float, float] | None
) -> np.ndarray:
    """Convert fractions of the image to pixels."""
    largest = np.nanmax(np.abs(points))
    if image_size is not None and largest > _FRACTION:
        raise InputError(
            f"{path} must have fractions of the width and height for --image-size. Received "
            f"coordinates of up to {largest:g}: leave --image-size out."
        )
    mediapipe = points.shape[1] in load_scheme("mediapipe").sizes
    if image_size is None and largest <= _FRACTION and mediapipe:
        raise InputError(
            f"{path} must be in pixels, or --image-size W H be given. Received coordinates of up "
            f"to {largest:.2g}, which seem to be fractions of the image, as MediaPipe has them."
        )
    return points if image_size is None else points * image_size


def _check_size(path: Path, max_bytes: int) -> None:
    if not path.is_file():
        received = "a folder or device" if path.exists() else "a path that does not exist"
    elif not (size := path.stat().st_size):
        received = "an empty file"
    elif size > max_bytes:
        received = f"{size:,} bytes"
    else:
        return
    most = f"at most {max_bytes >> 20} MiB"
    raise InputError(f"{path} must be a file of landmarks, of {most}. Received {received}.")


def _read_npy(path: Path, sizes: tuple[int, ...]) -> np.ndarray:
    return _as_faces(path, map_npy(path), sizes)


def _read_json(path: Path, sizes: tuple[int, ...]) -> np.ndarray:
    try:
        content = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} must be JSON. {_received(error)}") from None
    if isinstance(content, dict):
        key = next((key for key in _KEYS if key in content), None)
        if key is None:
            keys = ", ".join(f'"{key}"' for key in _KEYS)
            raise InputError(f"{path} must have one of the keys {keys}. Received none of them.")
        content = content[key]
    try:
        points = np.asarray(_without_null(_points(content)))
    except (ValueError, OverflowError, RecursionError):
        raise InputError(
            f"{path} must hold [x, y] for each landmark, as many in each face. "
            "Received lists of other lengths."
        ) from None
    return _as_faces(path, points, sizes)


def _points(item):
    """A landmark as `[x, y]`, or those of a face as a list of such."""
    if isinstance(item, dict):
        named = "x" in item or "y" in item
        return [item.get("x"), item.get("y")] if named else _points(item.get("landmarks"))
    nested = isinstance(item, list) and not isinstance(item[:1] and item[0], (int, float))
    return [*map(_points, item)] if nested else item


def _without_null(item):
    """Lists of numbers, with NaN for null and for lists of nothing else, as many as next to them.

    A list of nothing but null is None.
    """
    if not isinstance(item, list):
        return item
    items = [*map(_without_null, item)]
    if None not in items:
        return items
    known = next((each for each in items if each is not None), None)
    gap = np.full(np.shape(known), np.nan).tolist()
    return None if known is None else [gap if each is None else each for each in items]


def _as_faces(path: Path, points: np.ndarray, sizes: tuple[int, ...]) -> np.ndarray:
    """`(n, L, 2)` float64, of one face or of several, with or without depth."""
    if points.dtype.kind not in "iuf":
        kind = "text, null or objects" if points.dtype.kind in "OUS" else f"{points.dtype}"
        raise InputError(f"{path} must hold numbers only for its landmarks. Received {kind}.")
    if points.ndim not in (2, 3) or points.shape[-1] not in (2, 3) or not len(points):
        raise InputError(
            f"{path} must have shape (landmarks, 2) or (faces, landmarks, 2), and at least one "
            f"face. Received {points.shape}."
        )
    _check_count(path, points.shape[-2], sizes)
    return np.array(points.reshape(-1, *points.shape[-2:])[..., :2], float)


def _read_pts(path: Path, sizes: tuple[int, ...]) -> np.ndarray:
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    match = re.fullmatch(r"(.*?)^\s*\{\s*$(.*?)^\s*\}\s*$.*", text, re.DOTALL | re.MULTILINE)
    if not match:
        raise InputError(
            f"{path} must have its landmarks between lines of {{ and }}. "
            "Received no such lines: it is cut short, or no 300-W file."
        )
    points = []
    for line in filter(str.strip, match[2].splitlines()):
        try:
            x, y = map(float, line.split())
        except ValueError:
            raise InputError(
                f"{path} must have two numbers per landmark. Received {brief(line)!r}."
            ) from None
        points.append((x, y))
    stated = re.search(r"n_points\s*:\s*(\d+)", match[1])
    if stated and int(stated[1]) != len(points):
        raise InputError(
            f"{path} must have as many landmarks as it states, {stated[1]}. Received {len(points)}."
        )
    _check_count(path, len(points), sizes)
    return np.array([points]) - _MATLAB_ORIGIN


def _read_csv(path: Path, sizes: tuple[int, ...]) -> np.ndarray:
    with open(path, encoding="utf-8-sig", errors="replace", newline="") as file:
        first = next((line for line in file if line.strip() and not line.startswith("#")), "")
        rows = csv.reader(chain([first], file), skipinitialspace=True, strict=True)
        try:
            header = [cell.strip().lower() for cell in next(rows, [])]
            pair = next((pair for pair in _PAIRS if {*pair} <= {*header}), None)
            if pair is None:
                raise InputError(
                    f"{path} must have a header with columns x and y; save numbers without one as "
                    f".npy. Received the first line {brief(first, _SHOWN)!r}."
                )
            columns = [header.index(name) for name in (*pair, "number") if name in header]
            face = header.index("face") if "face" in header else None
            faces: list[str] = []
            values, end = array("d"), 0
            for row in rows:
                if len(row) > len(header):
                    raise InputError(
                        f"{path} must be a table of {len(header)} cells a row, as the header has. "
                        f"Received {len(row)} in row {len(faces) + 1}."
                    )
                row += [""] * (len(header) - len(row))
                values.extend([_number(row[column]) for column in columns])
                faces.append("" if face is None else row[face])
                end = len(faces) if any(row) else end  # empty lines at the end are not gaps
        except csv.Error as error:
            raise InputError(f"{path} must be a table of numbers. {_received(error)}") from None
    if not end:
        raise InputError(f"{path} must be a table of numbers. Received no rows.")
    table = np.array(values).reshape(-1, len(columns))[:end]
    size = _landmarks_per_face(path, faces[:end], face is not None, sizes)
    numbers = table[:, 2:].reshape(-1, size) if len(columns) > 2 else np.empty((0, size))
    if (np.diff(numbers) != 1).any() or (numbers[:, 0] != numbers[:1, 0]).any():
        raise InputError(
            f"{path} must have landmarks in the order of their numbers, the same in each face. "
            "Received another order in the column number."
        )
    return table[:, :2].reshape(-1, size, 2)


def _landmarks_per_face(path: Path, faces: list[str], named: bool, sizes: tuple[int, ...]) -> int:
    """L of a table with one landmark per row, where a face is a run of one value of `face`."""
    runs = [(face, len([*run])) for face, run in groupby(faces)]
    size = runs[0][1]
    for face, count in runs:
        if count != size:
            raise InputError(
                f"{path} must have the same number of landmarks in each face. Received {size}, "
                f"and {count} for the face {brief(face, _SHOWN)!r}."
            )
    _check_count(
        path, size, sizes, "" if named else " rows, and no column face that tells several apart"
    )
    return size


def _check_count(path: Path, n: int, sizes: tuple[int, ...], where: str = "") -> None:
    if n not in sizes:
        raise InputError(
            f"{path} must have {said_sizes(sizes)} landmarks a face. Received {n}{where}."
        )


def _number(cell: str) -> float:
    """A cell's number; infinity for text, NaN if it is empty."""
    try:
        return float(cell)
    except ValueError:
        return np.nan if cell.strip().lower() in _EMPTY else np.inf


def _received(error: Exception) -> str:
    return f"Received {type(error).__name__}: {brief(str(error))}"


_READERS = {".csv": _read_csv, ".json": _read_json, ".npy": _read_npy, ".pts": _read_pts}
