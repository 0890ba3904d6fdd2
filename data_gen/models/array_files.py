"""Arrays in Python pickles and in MATLAB files, read without executing anything in them.

SciPy's reader of MATLAB files is not safe: it looks types up by unchecked numbers from the file, so
that one wrong byte crashes the process, and allocates what a header claims. Format: "MAT-File
Format", The MathWorks, chapter 1 (version 5).
"""

import math
import pickle
import zlib
from collections.abc import Collection, Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import scipy.sparse

from deepmds_keras.errors import InputError, brief

# Python 2 and older versions of NumPy have other names for some modules.
_RENAMED = {"copy_reg": "copyreg", "__builtin__": "builtins"}
_PLAIN = {
    *("numpy.ndarray", "numpy.dtype", "numpy._core.multiarray._reconstruct"),
    *("numpy._core.multiarray.scalar", "numpy._core.numeric._frombuffer", "_codecs.encode"),
    *("copyreg._reconstructor", "builtins.object", "builtins.bytes"),
    "builtins.set",  # chumpy's objects hold an empty one
}
_SPARSE = {f"{kind}_{form}" for kind in ("csr", "csc", "coo") for form in ("matrix", "array")}


def load_plain_pickle(path: str | Path) -> object:
    """Read a pickle of dicts, lists, strings, numbers and arrays, written by Python 2 or 3.

    A pickle is a program that may call any function. Here it may name only those that build arrays
    and sparse matrices. Objects of chumpy, with which FLAME was fitted, become the arrays in them.

    Raises:
        InputError: The file is missing or damaged, or contains arrays of objects or anything else.
    """
    try:
        with Path(path).open("rb") as file:
            return _plain(_Unpickler(file, encoding="latin1").load())
    except OSError as error:
        raise InputError(f"{path}: must be a pickle. Received {error.strerror}.") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except Exception as error:  # the opcodes of a damaged pickle can go wrong in any way
        raise InputError(
            f"{path}: must be a whole Python pickle. Received {brief(repr(error))}."
        ) from None


class _Unpickler(pickle.Unpickler):
    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self._chumpy = type("Chumpy", (_Chumpy,), {})  # of this file alone: it may alter the class

    def find_class(self, module: str, name: str):
        if module.partition(".")[0] == "chumpy":
            return self._chumpy
        if module.startswith("scipy.sparse") and name in _SPARSE:
            return type(name, (getattr(scipy.sparse, name),), {})
        module = _RENAMED.get(module, module).replace("numpy.core", "numpy._core")
        if f"{module}.{name}" not in _PLAIN:
            raise InputError(
                "must be a pickle of plain arrays. Received one that asks for "
                f"{brief(f'{module}.{name}')}, which could run code; nothing was run."
            )
        return super().find_class(module, name)


class _Chumpy:
    """Substitute for an object of a missing class: its state, as attributes."""


def _plain(value: object) -> object:
    """The same with chumpy's objects replaced by what they hold, if the rest is data."""
    if isinstance(value, _Chumpy):
        value = vars(value).get("x")
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return type(value)(map(_plain, value))
    if scipy.sparse.issparse(value):
        # Checked, or a reader would go beyond its ends.
        if value.format == "coo":
            return scipy.sparse.coo_matrix((value.data, value.coords), shape=value.shape)
        value.check_format(full_check=True)
        return value
    is_data = value is None or isinstance(value, (str, bytes, bool, int, float, np.generic))
    if not is_data and (not isinstance(value, np.ndarray) or value.dtype.hasobject):
        raise InputError(f"must hold data only. Received {brief(repr(value), 60)}.")
    return value


# Type of the numbers by the number of a data type, and of an array's class.
_KINDS = ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8")
_STORED = dict(zip((9, 7, 1, 2, 3, 4, 5, 6, 12, 13), _KINDS, strict=True))
_CLASSES = dict(enumerate(_KINDS, start=6))
_MATRIX, _COMPRESSED, _COMPLEX = 14, 15, 0x800
_HEADER = 128  # bytes of the file
_START = 4096  # bytes of an array that its name is within; longer names are of no use here


def read_mat(path: Path, names: Collection[str]) -> dict[str, np.ndarray]:
    """Arrays of numbers by their names in a MATLAB file of versions 5 to 7, little-endian.

    They have at least two axes, as in MATLAB. Nothing else in the file is read.

    Raises:
        InputError: The file cannot be read, is truncated or damaged, or lacks one of the names, or
            the name stands for text, cells, structures, or sparse or complex arrays.
    """
    try:
        content = memoryview(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: must be a MATLAB file. Received {error.strerror}.") from None
    if bytes(content[:6]) != b"MATLAB" or bytes(content[126:_HEADER]) != b"IM":
        raise InputError(
            f"{path}: must be a MATLAB v5 to v7 file, not v7.3 (HDF5). "
            f"Received one that begins with {bytes(content[:10])!r}."
        )
    try:
        arrays = dict(_arrays(content[_HEADER:], {*names}))
    except (ValueError, zlib.error) as error:
        raise InputError(f"{path}: must be a whole MATLAB file. Received {error!r}.") from None
    if missing := [name for name in names if name not in arrays]:
        raise InputError(
            f"{path}: must hold arrays of numbers {', '.join(names)}. "
            f"Received a file without {', '.join(missing)}."
        )
    return arrays


def _arrays(content: memoryview, names: set[str]) -> Iterator[tuple[str, np.ndarray]]:
    for kind, array in _elements(content, aligned=False):
        if kind == _COMPRESSED:
            begins = memoryview(zlib.decompressobj().decompress(array, _START))
            if _name(begins[8:]) not in names:
                continue
            length = 8 + int.from_bytes(begins[4:8], "little")
            whole = memoryview(zlib.decompressobj().decompress(array, length))
            ((kind, array),) = islice(_elements(whole, aligned=False), 1)
        if kind == _MATRIX and (name := _name(array)) in names:
            numbers = _numbers(array)
            if numbers is not None:
                yield name, numbers


def _name(array: memoryview) -> str:
    """Of an array, or of the beginning of one, after its flags and dimensions."""
    _, _, (_, name) = islice(_elements(array), 3)
    return bytes(name).decode("latin1")


def _numbers(array: memoryview) -> np.ndarray | None:
    """The array; None if it does not hold real numbers."""
    (_, flags), (_, dimensions), _, (stored, content) = islice(_elements(array), 4)
    flag = int.from_bytes(flags[:4], "little")
    if flag & 0xFF not in _CLASSES or flag & _COMPLEX:
        return None
    if stored not in _STORED:
        raise ValueError(f"numbers of type {stored}")
    shape = np.frombuffer(dimensions, "<i4").tolist()
    numbers = np.frombuffer(content, f"<{_STORED[stored]}")
    if len(shape) < 2 or min(shape) < 0 or math.prod(shape) != len(numbers):
        raise ValueError(f"an array {shape} of {len(numbers)} numbers")
    return numbers.astype(_CLASSES[flag & 0xFF]).reshape(shape, order="F")


def _elements(content: memoryview, *, aligned: bool = True) -> Iterator[tuple[int, memoryview]]:
    """Type and content of one element after the other."""
    start = 0
    while start < len(content):
        kind, length = np.frombuffer(content[start : start + 8], "<u4").tolist()
        first = 8
        if kind >> 16:  # a short element: length, type and content within eight bytes
            kind, length, first = kind & 0xFFFF, kind >> 16, 4
        end = start + first + length
        if end > len(content) or first + length > 8 and first == 4:
            raise ValueError(f"{len(content)} bytes where an element ends at {end}")
        yield kind, content[start + first : end]
        start = end + (-(first + length) % 8 if aligned or first == 4 else 0)
