"""Arrays of numbers in MATLAB files of versions 5 to 7.

Read here and not by SciPy: its reader looks types up by numbers from the file without checking
them, so that one wrong byte ends the process, and allots what a header claims.

Format: "MAT-File Format", The MathWorks, chapter 1 (version 5).
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deepmds_keras.errors import InputError

# Type of the numbers by the number of a data type, and of an array's class.
_STORED = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}
_CLASSES = {
    **{6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8"},
    **{15: "u8"},
}
_FLAGS, _DIMENSIONS, _NAMES = (6,), (5, 6), (1, 16)  # the second of two is some writers' own
_MATRIX, _COMPRESSED = 14, 15
_COMPLEX = 0x08  # among the flags
_HEADER = 128  # bytes of the file
_START = 4096  # bytes of an array that its name is within; longer names are of no use here


class _Element(NamedTuple):
    kind: int
    content: memoryview
    end: int  # where the next begins


def read_mat(path: Path, names: Collection[str]) -> dict[str, np.ndarray | None]:
    """Arrays of a MATLAB file.

    Args:
        path: The file.
        names: Those wanted; nothing else in the file is looked at.

    Returns:
        What there is of them, as MATLAB has it: never less than two axes. None stands for text,
        cells, structures, and sparse or complex arrays.

    Raises:
        InputError: The file cannot be read, is cut short or damaged.
    """
    try:
        content = memoryview(path.read_bytes())
        order = {b"IM": "<", b"MI": ">"}[bytes(content[126:_HEADER])]
        return dict(_arrays(content, order, {*names}))
    except OSError as error:
        raise InputError(f"{path}: must be a MATLAB file. Received {error.strerror}.") from None
    except (KeyError, ValueError, zlib.error) as error:
        raise InputError(f"{path}: must be a whole MATLAB file. Received {error!r}.") from None


def _arrays(
    content: memoryview, order: str, names: set[str]
) -> Iterator[tuple[str, np.ndarray | None]]:
    start = _HEADER
    while start < len(content):
        kind, packed, start = _element(content, start, order, aligned=False)
        if kind == _COMPRESSED:
            begins = memoryview(zlib.decompressobj().decompress(packed, _START))
            if _name(begins[8:], order) not in names:
                continue
            length = 8 + _tag(begins, 0, order)[1]
            kind, array, _ = _element(
                memoryview(zlib.decompressobj().decompress(packed, length)), 0, order, aligned=False
            )
        else:
            array = packed
        if kind == _MATRIX and _name(array, order) in names:
            yield _name(array, order), _numbers(array, order)


def _name(array: memoryview, order: str) -> str:
    """Of an array, or of the beginning of one."""
    return bytes(_parts(array, order)[2].content).decode("latin1")


def _parts(array: memoryview, order: str) -> tuple[_Element, _Element, _Element]:
    """Flags, dimensions and name."""
    flags = _element(array, 0, order)
    dimensions = _element(array, flags.end, order)
    name = _element(array, dimensions.end, order)
    is_known = flags.kind in _FLAGS and dimensions.kind in _DIMENSIONS and name.kind in _NAMES
    if not is_known or len(flags.content) != 8:
        kinds = flags.kind, dimensions.kind, name.kind
        raise ValueError(f"an array that begins with the types {kinds}")
    return flags, dimensions, name


def _numbers(array: memoryview, order: str) -> np.ndarray | None:
    """The array in native byte order; None where it is not of real numbers."""
    flags, dimensions, name = _parts(array, order)
    flag = int.from_bytes(flags.content[:4], "little" if order == "<" else "big")
    if flag & 0xFF not in _CLASSES or flag >> 8 & _COMPLEX:
        return None
    shape = np.frombuffer(dimensions.content, f"{order}i4").tolist()
    stored = _element(array, name.end, order)
    if stored.kind not in _STORED:
        raise ValueError(f"numbers of type {stored.kind}")
    numbers = np.frombuffer(stored.content, order + _STORED[stored.kind])
    if len(shape) < 2 or min(shape) < 0 or math.prod(shape) != len(numbers):
        raise ValueError(f"an array {shape} of {len(numbers)} numbers")
    return numbers.astype(_CLASSES[flag & 0xFF]).reshape(shape, order="F")


def _element(content: memoryview, start: int, order: str, *, aligned: bool = True) -> _Element:
    kind, length, first = _tag(content, start, order)
    if start + first + length > len(content):
        raise ValueError(f"{len(content)} bytes where an element needs {start + first + length}")
    used = 8 if first == 4 else first + length
    end = start + (-(-used // 8) * 8 if aligned else used)
    return _Element(kind, content[start + first : start + first + length], end)


def _tag(content: memoryview, start: int, order: str) -> tuple[int, int, int]:
    """Type, length in bytes, and how far off the content begins: 8 bytes, or 4 if it is short."""
    if len(content) < start + 8:
        raise ValueError(f"{len(content)} bytes where an element begins at {start}")
    kind, length = np.frombuffer(content[start : start + 8], f"{order}u4").tolist()
    if kind >> 16:
        if kind >> 16 > 4:
            raise ValueError(f"a short element of {kind >> 16} bytes")
        return kind & 0xFFFF, kind >> 16, 4
    return kind, length, 8
