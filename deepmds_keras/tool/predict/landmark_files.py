"""Reads 2D landmarks from files: NPY, PTS, tables and JSON of this program, MediaPipe's JSON."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np

from deepmds_keras.errors import InputError, brief
from deepmds_keras.files import instead_of_file, map_npy
from deepmds_keras.landmarks import face_sizes, load_scheme
from deepmds_keras.landmarks.arrays import (
    LARGEST_FRACTION,
    as_faces,
    largest_coordinates,
    seem_fractions,
    typical_of,
)
from deepmds_keras.lifting.inputs import FLAT, LEAST_VISIBLE, flatness, standardise
from deepmds_keras.tool.predict.landmark_tables import check_count, encoding_of, read_landmark_table
from deepmds_keras.validation import check_number, find_faults

_TOO_LARGE = 1e9  # for any image; squares of far larger numbers overflow
# The live page saves up to 18,000 faces, 86 MB of JSON.
_MAX_BYTES = {".csv": 1 << 29, ".json": 1 << 27, ".npy": 1 << 29, ".pts": 1 << 20}
SUFFIXES = tuple(_MAX_BYTES)
# Of landmarks in JSON: of this program, of MediaPipe in Python and JavaScript, of TensorFlow.js.
_KEYS = (
    *("faces", "landmarks", "landmark", "face_landmarks", "faceLandmarks", "multi_face_landmarks"),
    *("multiFaceLandmarks", "keypoints"),
)
_MATLAB_ORIGIN = 0.5  # MATLAB's first pixel has its middle at (1, 1), ours at (0.5, 0.5)
# Columns of landmarks; x and y in our own tables are those of the 3D shape.
_AXES = (("image_x", "image_y"), ("x", "y", "z"), ("x", "y"))
Z_UNUSED = "z of the landmarks is not used: the shape is estimated from x and y"
FRACTIONS = (
    "Received coordinates between 0 and 1, which seem to be fractions of an image: multiply x by "
    "its width and y by its height, or both by 1000 if they are in one unit"
)


def read_landmarks(
    path: str | Path,
    *,
    y_up: bool = False,
    image_size: tuple[float, float] | None = None,
    scheme: str | Path | None = None,
) -> np.ndarray:
    """Read 2D landmarks of one or more faces, or other objects, all with the same L.

    x and y must be in the same unit, or fractions of the width and of the height, as MediaPipe
    gives them. A third coordinate is not used.

    - `.npy`: `(L, 2)`, `(n, L, 2)`, `(L, 3)` or `(n, L, 3)`, or with coordinates first.
    - `.csv`: with a header, see `read_landmark_table`. Columns `image_x` and `image_y`, as
      `deepmds predict` writes them, or `x` and `y`; or `x_0`, …, `y_0`, …, as OpenFace has them.
    - `.pts` (iBUG 300-W), one face, in MATLAB's pixels: 0.5 is subtracted.
    - `.json`: a list of `[x, y]` or, like MediaPipe's, of `{"x": …, "y": …}`; a list of such
      faces; or either under a key: `faces`, `landmarks`, `landmark`, `face_landmarks`,
      `faceLandmarks`, `multi_face_landmarks`, `multiFaceLandmarks` or `keypoints`.

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
    points, faults, _ = read_faces(path, y_up=y_up, image_size=image_size, scheme=scheme)
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
) -> tuple[np.ndarray, dict[int, str], list[str]]:
    """`read_landmarks`, with unusable faces turned into gaps.

    Returns:
        The landmarks; the number of each unusable face, 0-based and ascending, → the reason; and
        what a reader must know about the file.

    Raises:
        InputError: As for `read_landmarks`, but for faces only if none can be used.
    """
    if image_size is not None:
        if np.shape(image_size) != (2,):
            raise InputError(f"image_size must be a width and a height. Received {image_size!r}.")
        for side in image_size:
            check_number(side, "image_size")
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        raise InputError(f"{path} must end in {', '.join(SUFFIXES)}. Received {suffix!r}.")
    sizes = face_sizes() if scheme is None else load_scheme(scheme).sizes
    try:
        _check_size(path, _MAX_BYTES[suffix])
        read = _READERS[suffix](path, sizes)
    except (OSError, MemoryError, RecursionError) as error:
        raise InputError(f"{path} must be a readable file. {_received(error)}") from None
    if not len(read):
        raise InputError(f"{path} must hold at least one face. Received none.")
    check_count(path, read.shape[1], sizes)
    points = np.array(read[..., :2], float)
    points[np.isnan(points).any(2)] = np.nan  # half a landmark is none
    faults = _find_faults(points)
    points[[*faults]] = np.nan
    if np.isnan(points).all():
        if not faults:
            raise InputError(f"{path} must hold landmarks. Received only gaps (NaN).")
        face = min(faults)
        where = f"{path}, face {face + 1} of {len(points)}," if len(points) > 1 else path
        raise InputError(f"{where} {faults[face]}.")
    is_face = scheme is None or load_scheme(scheme).is_face
    if image_size is not None:
        faults |= _find_beyond(path, points)
        points[[*faults]] = np.nan
        points *= image_size
    elif is_face and seem_fractions(points):  # other objects may be in any unit
        raise InputError(f"{path} must be in pixels, or pass --image-size W H. {FRACTIONS}.")
    if y_up:
        points[..., 1] *= -1
    return points, dict(sorted(faults.items())), [Z_UNUSED] if read.shape[2] > 2 else []


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
    points = np.where(missing, middles[:, None], points)
    faults = find_faults(points)
    # What the lifter would refuse, and all other faces of the file with it.
    views, _, _ = standardise(np.swapaxes(points, 1, 2), np.ones(points.shape[:2], bool))
    for face in np.flatnonzero(flatness(views, points.shape[1]) <= FLAT).tolist():
        faults.setdefault(face, "must not be degenerate: all landmarks lie on one line")
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


def _find_beyond(path: Path, points: np.ndarray) -> dict[int, str]:
    """Faces whose coordinates are too large for fractions, if most are not: else an InputError."""
    largest = largest_coordinates(points)
    if typical_of(largest) > LARGEST_FRACTION:
        raise InputError(
            f"{path} must have fractions of the width and height for --image-size. Received "
            f"coordinates of up to {largest.max():g}: omit --image-size."
        )
    return {
        face: f"must have fractions of the image. Received {largest[face]:g}"
        for face in np.flatnonzero(largest > LARGEST_FRACTION).tolist()
    }


def _check_size(path: Path, max_bytes: int) -> None:
    if not path.is_file():
        received = instead_of_file(path)
    elif not (size := path.stat().st_size):
        received = "an empty file"
    elif size > max_bytes:
        received = f"{size:,} bytes"
    else:
        return
    most = f"at most {max_bytes >> 20} MiB"
    raise InputError(f"{path} must be a landmark file, {most}. Received {received}.")


def _read_json(path: Path, sizes: tuple[int, ...]) -> np.ndarray:
    try:
        content = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} must be JSON. {_received(error)}") from None
    points = _points(path, content)
    if points == []:  # as MediaPipe writes of a picture without a face
        return np.empty((0, 0, 2))
    return as_faces(points, str(path), sizes)


def _points(path: Path, item):
    """A landmark as `[x, y]`, or those of a face as a list of such."""
    if isinstance(item, dict):
        if "x" in item or "y" in item:
            return [item.get("x"), item.get("y")]
        keys = [key for key in _KEYS if key in item]
        if len(keys) != 1:
            raise InputError(
                f"{path} must have one of the keys {', '.join(_KEYS)}. "
                f"Received {' and '.join(keys) or 'none of them'}."
            )
        return _points(path, item[keys[0]])
    nested = isinstance(item, list) and not isinstance(item[:1] and item[0], (int, float))
    return [_points(path, each) for each in item] if nested else item


def _read_pts(path: Path, sizes: tuple[int, ...]) -> np.ndarray:
    text = path.read_text(encoding=encoding_of(path), errors="replace")
    match = re.fullmatch(r"(.*?)^\s*\{\s*$(.*?)^\s*\}\s*$(.*)", text, re.DOTALL | re.MULTILINE)
    if not match:
        raise InputError(
            f"{path} must have its landmarks between lines of {{ and }}. "
            "Received no such lines: it is truncated, or not a 300-W file."
        )
    if "{" in match[3]:
        raise InputError(
            f"{path} must hold one face. Received several: write each to a file of its own, or all "
            "to a .csv with a column face."
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
    return np.array([points]).reshape(1, -1, 2) - _MATLAB_ORIGIN


def _received(error: Exception) -> str:
    return f"Received {type(error).__name__}: {brief(str(error))}"


_READERS = {
    ".csv": lambda path, sizes: read_landmark_table(path, *_AXES, sizes=sizes),
    ".json": _read_json,
    ".npy": lambda path, sizes: as_faces(map_npy(path), str(path), sizes),
    ".pts": _read_pts,
}
