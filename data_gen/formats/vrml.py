"""Points of a scan as text: VRML files, and lists of bare coordinates."""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import chain
from pathlib import Path

import numpy as np

from deepmds_keras.errors import InputError

MAX_BYTES = 1 << 27  # five times per scan of 200,000 points with normals, colours and triangles

# Strings go first, since they may hold a "#". The mark of a comment stands apart: "1.#QNAN" is how
# some writers spell NaN, and cutting it to "1." would hide that.
_STRING = re.compile(rb'"[^"\r\n]*"')
_COMMENT = re.compile(rb"#(?<![^\s,\[\]{}]#)[^\r\n]*")
_BLOCK = re.compile(rb"point\s*\[([^\[\]]*)(\]?)")
# Before "point": the points of a texture are in its image; a letter makes it another word.
_NOT_COORDINATES = re.compile(rb"(?:texturecoordinate2?\s*\{\s*|\w)\Z")
_LOOK_BACK = 64  # characters before "point" that are looked at


def read_vrml_points(path: str | Path) -> np.ndarray:
    """Points of a VRML 1 or 2 text, of the largest block `Coordinate { point [ … ] }`.

    Commas, line ends, comments and upper or lower case do not matter. Transformations around the
    shape are not applied: the points are as the file lists them.

    Args:
        path: A `.wrl` file, not compressed, of at most `MAX_BYTES`.

    Returns:
        `(n, 3)` float64, `n >= 1`, finite, in the file's unit and order.

    Raises:
        InputError: The file cannot be read, is too large, has no such block or one without end, or
            a block does not hold three finite numbers per point.
    """
    path = Path(path)
    raw = _read(path)
    text = _COMMENT.sub(b" ", _STRING.sub(b" ", raw.lower()))
    blocks = []
    for match in _BLOCK.finditer(text):
        before = text[max(match.start() - _LOOK_BACK, 0) : match.start()]
        if _NOT_COORDINATES.search(before):
            continue
        numbers, end = match.groups()
        if not end:
            raise InputError(f"{path}: must end its block 'point [' by ']'. Received none.")
        blocks.append(_points(path, numbers.replace(b",", b" ").split()))
    if not blocks:
        raise InputError(
            f"{path}: must be a VRML text with a block Coordinate {{ point [ … ] }}. "
            f"Received none in a file that begins with {raw[:16]!r}."
        )
    return max(blocks, key=len)


def read_asc_points(path: str | Path) -> np.ndarray:
    """Points of a text of bare lines "x y z"; empty lines and `#` comments are skipped.

    Args:
        path: A `.asc` file of at most `MAX_BYTES`.

    Returns:
        `(n, 3)` float64, `n >= 1`, finite, in the file's unit and order.

    Raises:
        InputError: The file cannot be read, is too large, or a line is not three finite numbers.
    """
    path = Path(path)
    text = _COMMENT.sub(b" ", _read(path)).replace(b",", b" ")
    rows = [words for line in text.splitlines() if (words := line.split())]
    other = {*map(len, rows)} - {3}
    if other:
        raise InputError(f"{path}: must hold three numbers per line. Received {min(other)}.")
    return _points(path, chain.from_iterable(rows))


def _read(path: Path) -> bytes:
    try:
        size = path.stat().st_size
        if size <= MAX_BYTES:
            return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: must be a scan that can be read. Received {error}.") from error
    raise InputError(f"{path}: must be a scan of at most {MAX_BYTES} bytes. Received {size}.")


def _points(path: Path, words: Iterable[bytes]) -> np.ndarray:
    try:
        numbers = np.fromiter(map(float, words), np.float64)
    except ValueError as error:
        reason = str(error)[:80]
        raise InputError(f"{path}: points must be numbers. Received: {reason}.") from error
    if not len(numbers) or len(numbers) % 3:
        raise InputError(
            f"{path}: must hold three numbers per point. Received {len(numbers)} in all."
        )
    if not np.isfinite(numbers).all():
        raise InputError(f"{path}: points must be finite. Received NaN or infinity.")
    return numbers.reshape(-1, 3)
