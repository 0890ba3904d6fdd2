"""Reads 2D landmarks from the files that other tools, and this one, write."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np

from deepmds_keras.checks import find_faults
from deepmds_keras.errors import InputError, brief
from deepmds_keras.files import map_npy
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.landmarks.conversion import said_sizes
from deepmds_keras.predict.landmark_tables import EMPTY, check_count, read_csv, row_lengths

_FRACTION = 2  # at most, of the width or height of an image; a face may reach beyond it
_TOO_LARGE = 1e9  # no image is, and the squares of far greater numbers overflow
_MAX_BYTES = {".csv": 1 << 29, ".json": 1 << 26, ".npy": 1 << 29, ".pts": 1 << 20}
SUFFIXES = tuple(_MAX_BYTES)
_KEYS = ("faces", "landmarks", "faceLandmarks")  # the last is MediaPipe's in JavaScript
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
    except (OSError, MemoryError) as error:
        raise InputError(f"{path} must be a file that can be read. {_line(error)}") from None
    except csv.Error as error:
        raise InputError(f"{path} must be a table of numbers. {_line(error)}") from None
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
        if cells.get(face, EMPTY).startswith(EMPTY):
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
        check_count(path, shape[-2])
        faces = array.reshape(-1, *shape[-2:])[..., :2]
    elif len(shape) in (1, 2) and shape[-1] in row_lengths():
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
                f"{path} must have two numbers per landmark. Received {brief(line)!r} in line {i}."
            ) from None
    check_count(path, len(points))
    return np.array([points]) - _MATLAB_ORIGIN, {}


def _line(error: Exception) -> str:
    return f"Received {type(error).__name__}: {brief(str(error))}"


_READERS = {".csv": read_csv, ".json": _read_json, ".npy": _read_npy, ".pts": _read_pts}
