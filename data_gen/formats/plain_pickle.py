"""Pickles that hold data only, such as FLAME's, read without running anything that they name.

A pickle is a program that may call any function. Here every name in it is either one of a few that
stand for plain data, and is replaced by a record of its own, or the file is refused.
"""

from __future__ import annotations

import io
import math
import pickle
import re
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix

from data_gen.formats.pickle_opcodes import check_opcodes
from deepmds_keras.io.errors import InputError, brief

_DTYPE = re.compile(r"[biufcSU][0-9]+")
_SPARSE = re.compile(r"scipy\.sparse(\._?(csc|csr|coo))?:(csc|csr|coo)_(matrix|array)")
_LONGEST_SIDE = 1 << 24  # of a sparse matrix, which could claim any


def load_plain_pickle(path: str | Path) -> object:
    """Reads a pickle of containers, strings, numbers and arrays, written by Python 2 or 3.

    SciPy's sparse matrices become `csr_matrix`, built anew and checked. Objects of chumpy, which
    FLAME was fitted with, become the arrays that they hold, or a dict of what else they hold. A
    text pickle (protocol 0) whose line ends became CRLF on the way is repaired.

    Args:
        path: The file.

    Raises:
        InputError: The file is missing or damaged, or holds arrays of objects or anything else.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: must be a pickle that can be read. Received {error}.") from error
    try:
        if check_opcodes(data) == 0:
            data = data.replace(b"\r\n", b"\n")  # protocol 0 writes no CR of its own
        return _resolve(_Unpickler(io.BytesIO(data), encoding="latin1").load(), {})
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except Exception as error:  # the opcodes of a damaged pickle can go wrong in any way
        raise InputError(
            f"{path}: must be a whole Python pickle. Received a file that begins with "
            f"{data[:8]!r}, {len(data)} bytes: {brief(repr(error))}."
        ) from error


class _Record:
    """What a pickle says of one object: the arguments it would be made of, and its state.

    Each must have `__setstate__` and `__slots__`, or the opcode BUILD could change the class.
    """

    __slots__ = ("arguments", "state")

    def __init__(self, *arguments):
        self.arguments = arguments
        self.state = None

    def __setstate__(self, state):
        self.state = state

    def value(self, seen: dict):
        raise InputError("must hold data only. Received a bare name.")


class _Dtype(_Record):
    __slots__ = ()

    def value(self, seen):
        name = self.arguments[0]
        if not (isinstance(name, str) and _DTYPE.fullmatch(name)):
            raise InputError(
                f"must hold arrays of plain numbers. Received dtype {brief(repr(name))}."
            )
        byte_order = "=" if self.state is None else self.state[1]
        return np.dtype(name).newbyteorder(byte_order)


class _Array(_Record):
    """`_reconstruct(ndarray, ...)`, its state `(version, shape, dtype, is_fortran, bytes)`."""

    __slots__ = ()

    def value(self, seen):
        shape, dtype, is_fortran, raw = self.state[-4:]
        return _array(raw, dtype, shape, "F" if is_fortran else "C", seen)


class _ArrayOfBuffer(_Record):
    """`_frombuffer(buffer, dtype, shape, order)`; the order of the axes follows order K."""

    __slots__ = ()

    def value(self, seen):
        raw, dtype, shape, order, *axes = self.arguments
        array = _array(raw, dtype, shape, "C" if order == "K" else order, seen)
        return array.transpose(*axes) if order == "K" else array


class _Scalar(_Record):
    __slots__ = ()

    def value(self, seen):
        dtype, raw = self.arguments
        return _array(raw, dtype, (), "C", seen)[()]


class _Chumpy(_Record):
    __slots__ = ()

    def value(self, seen):
        holds_x = isinstance(self.state, dict) and "x" in self.state
        return _resolve(self.state["x"] if holds_x else self.state, seen)


class _Csr(_Record):
    __slots__ = ()

    def value(self, seen):
        state = _resolve(self.state, seen)
        n_rows, n_columns = shape = state["_shape"] if "_shape" in state else state["shape"]
        if not (0 <= n_rows <= _LONGEST_SIDE and 0 <= n_columns <= _LONGEST_SIDE):
            raise ValueError(f"a sparse matrix of shape {shape}")
        rows, columns, data = self._entries(state, shape)
        for numbers, length in ((rows, n_rows), (columns, n_columns)):
            if numbers.dtype.kind not in "iu" or data.ndim != 1 or numbers.shape != data.shape:
                raise ValueError("a sparse matrix whose indices do not match its data")
            if len(numbers) and not 0 <= numbers.min() <= numbers.max() < length:
                raise ValueError(f"a sparse matrix {shape} with indices out of range")
        return csr_matrix((data, (rows, columns)), shape=shape)

    def _entries(self, state, shape):
        return _uncompress(state, shape[0])


class _Csc(_Csr):
    __slots__ = ()

    def _entries(self, state, shape):
        columns, rows, data = _uncompress(state, shape[1])
        return rows, columns, data


class _Coo(_Csr):
    __slots__ = ()

    def _entries(self, state, shape):
        rows, columns = state["coords"] if "coords" in state else (state["row"], state["col"])
        return rows, columns, state["data"]


class _Bytes(_Record):
    """`_codecs.encode`, by which Python 3 writes bytes into protocols without, and `bytes()`."""

    __slots__ = ()

    def __new__(cls, text="", encoding="utf-8"):
        if not isinstance(text, str) or encoding not in ("latin1", "utf-8"):
            raise ValueError(f"bytes of {type(text).__name__}")
        return text.encode(encoding)


class _Reconstructor(_Record):
    """`copyreg._reconstructor(class, object, None)`, which protocols 0 and 1 make objects by."""

    __slots__ = ()

    def __new__(cls, made, base, state):
        if not (isinstance(made, type) and issubclass(made, (_Chumpy, _Csr))):
            raise ValueError("_reconstructor of another class")
        return made()


_ALLOWED = {
    "_codecs:encode": _Bytes,
    "copy_reg:_reconstructor": _Reconstructor,
    "copyreg:_reconstructor": _Reconstructor,
    "collections:OrderedDict": dict,
    "numpy:ndarray": _Record,
    "numpy:dtype": _Dtype,
}
for _builtins in ("__builtin__", "builtins"):
    _ALLOWED |= {
        f"{_builtins}:object": _Record,
        f"{_builtins}:bytes": _Bytes,
        f"{_builtins}:set": set,
        f"{_builtins}:frozenset": frozenset,
        f"{_builtins}:complex": complex,
    }
for _numpy in ("numpy.core", "numpy._core"):
    _ALLOWED |= {
        f"{_numpy}.multiarray:_reconstruct": _Array,
        f"{_numpy}.multiarray:scalar": _Scalar,
        f"{_numpy}.numeric:_frombuffer": _ArrayOfBuffer,
    }


class _Unpickler(pickle.Unpickler):
    def find_class(self, module, name):
        if f"{module}:{name}" in _ALLOWED:
            return _ALLOWED[f"{module}:{name}"]
        if module.partition(".")[0] == "chumpy":
            return _Chumpy
        if sparse := _SPARSE.fullmatch(f"{module}:{name}"):
            return {"csr": _Csr, "csc": _Csc, "coo": _Coo}[sparse[3]]
        raise InputError(
            "must be a pickle of plain arrays. Received one that asks for "
            f"{brief(f'{module}.{name}')}, which could run code; nothing was run."
        )


def _resolve(value: object, seen: dict):
    """The same data with every record replaced by what it stands for, each once."""
    if not isinstance(value, (list, tuple, dict, set, frozenset, _Record)):
        if isinstance(value, type):
            raise InputError("must hold data only. Received a bare name.")
        return value
    found = seen.get(id(value))
    if found is seen:
        raise ValueError("data that contains itself")
    if found is not None:
        return found
    seen[id(value)] = seen
    if isinstance(value, _Record):
        found = value.value(seen)
    elif isinstance(value, dict):
        found = {_resolve(key, seen): _resolve(item, seen) for key, item in value.items()}
    else:
        found = type(value)(_resolve(item, seen) for item in value)
    seen[id(value)] = found
    return found


def _array(raw, dtype, shape, order: str, seen: dict) -> np.ndarray:
    dtype = _resolve(dtype, seen)
    if isinstance(raw, str):
        raw = raw.encode("latin1")  # Python 2 wrote bytes as text
    if len(raw) != math.prod(shape) * dtype.itemsize:
        raise ValueError(f"an array {shape} of {dtype} with {len(raw)} bytes")
    array = np.frombuffer(raw, dtype).reshape(shape, order=order)
    return array.astype(dtype.newbyteorder("="), order="C")


def _uncompress(state: dict, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Row, column and value of every entry of CSR; column, row and value of CSC."""
    starts, numbers, data = state["indptr"], state["indices"], state["data"]
    if starts.shape != (n + 1,) or starts.dtype.kind not in "iu":
        raise ValueError(f"a sparse matrix whose indptr is not of {n} rows or columns")
    starts = starts.astype(np.int64)
    lengths = np.diff(starts)
    if starts[0] != 0 or (lengths < 0).any() or starts[-1] > min(len(numbers), len(data)):
        raise ValueError("a sparse matrix whose indptr does not match its indices")
    used = slice(starts[-1])  # what lies beyond is room for more
    return np.repeat(np.arange(n), lengths), numbers[used], data[used]
