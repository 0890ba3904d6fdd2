"""Pickles that hold data only, such as FLAME's, read without running anything that they name.

A pickle is a program that may call any function. Here every name in it is one of a few that stand
for plain data, and is replaced by a record of our own, or the file is refused.
"""

from __future__ import annotations

import io
import math
import pickle
import re
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix, csr_matrix

from deepmds_keras.errors import InputError, brief

_DTYPE = re.compile(r"[biufcSU][0-9]+")
_SPARSE = re.compile(r"scipy\.sparse(?:\._?(?:csc|csr|coo))?:(csc|csr|coo)_(?:matrix|array)")


def load_plain_pickle(path: str | Path) -> object:
    """Read a pickle of containers, strings, numbers and arrays, written by Python 2 or 3.

    Tuples and sets become lists. SciPy's sparse matrices are built anew and checked. Objects of
    chumpy, which FLAME was fitted with, become the arrays that they hold, or a dict of what else
    they hold. A text pickle (protocol 0) whose line ends became CRLF on the way is repaired.

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
        return _load(data)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except Exception as error:  # the opcodes of a damaged pickle can go wrong in any way
        raise InputError(
            f"{path}: must be a whole Python pickle. Received a file that begins with "
            f"{data[:8]!r}, {len(data)} bytes: {brief(repr(error))}."
        ) from error


def _load(data: bytes) -> object:
    try:
        return _resolve(_Unpickler(_Data(data), encoding="latin1").load(), {})
    except Exception:  # of a text pickle with CRLF at least the names of arrays are unknown
        if b"\r\n" not in data or data[:1] == pickle.PROTO:
            raise
        return _load(data.replace(b"\r\n", b"\n"))


class _Data(io.BytesIO):
    """A file of which every read is complete."""

    def read(self, size):
        part = super().read(size)
        if len(part) < size:
            raise EOFError(f"{size} bytes needed, {len(part)} left")
        return part

    def readline(self):
        line = super().readline()
        if not line.endswith(b"\n"):
            raise EOFError("a line without an end")
        return line


class _Record:
    """One object of a pickle: the arguments it would be made of, and its state.

    Without `__setstate__` the opcode BUILD could change the class.
    """

    arguments: tuple = ()
    state = None

    def __init__(self, *arguments):
        self.arguments = arguments

    def __setstate__(self, state):
        self.state = state

    def value(self, seen: dict):
        raise InputError("must hold data only. Received a bare name.")


class _Dtype(_Record):
    def value(self, seen):
        name = self.arguments[0]
        if not isinstance(name, str) or not _DTYPE.fullmatch(name):
            found = brief(repr(name)) if isinstance(name, str) else type(name).__name__
            raise InputError(f"must hold arrays of plain numbers. Received dtype {found}.")
        byte_order = "=" if self.state is None else self.state[1]
        return np.dtype(name).newbyteorder(byte_order)


class _Array(_Record):
    """`_reconstruct(ndarray, ...)`, its state `(version, shape, dtype, is_fortran, bytes)`."""

    def value(self, seen):
        shape, dtype, is_fortran, raw = self.state[-4:]
        return _array(raw, dtype, shape, "F" if is_fortran else "C", seen)


class _ArrayOfBuffer(_Record):
    """`_frombuffer(buffer, dtype, shape, order)`; the order of the axes follows order K."""

    def value(self, seen):
        raw, dtype, shape, order, *axes = self.arguments
        array = _array(raw, dtype, shape, "C" if order == "K" else order, seen)
        return array.transpose(*axes) if order == "K" else array


class _Scalar(_Record):
    def value(self, seen):
        dtype, raw = self.arguments
        return _array(raw, dtype, (), "C", seen)[()]


class _Chumpy(_Record):
    def value(self, seen):
        holds_x = isinstance(self.state, dict) and "x" in self.state
        return _resolve(self.state["x"] if holds_x else self.state, seen)


class _Sparse(_Record):
    def value(self, seen):
        state = _resolve(self.state, seen)
        shape = state["_shape"] if "_shape" in state else state["shape"]
        if "indptr" in state:
            parts = state["data"], _integers(state["indices"]), _integers(state["indptr"])
        else:
            rows, columns = state["coords"] if "coords" in state else (state["row"], state["col"])
            parts = state["data"], (_integers(rows), _integers(columns))
        matrix = self.kind(parts, shape=shape)
        if "indptr" in state:
            matrix.check_format(full_check=True)  # or who reads it would read beyond its ends
        return matrix


_KINDS = {
    kind: type(f"_{kind}", (_Sparse,), {"kind": matrix})
    for kind, matrix in (("csr", csr_matrix), ("csc", csc_matrix), ("coo", coo_matrix))
}


class _Bytes(_Record):
    """`_codecs.encode`, by which Python 3 writes bytes into protocols without, and `bytes()`."""

    def __new__(cls, text="", encoding="utf-8"):
        if not isinstance(text, str) or encoding not in ("latin1", "utf-8"):
            raise ValueError(f"bytes of {type(text).__name__}")
        return text.encode(encoding)


class _Reconstructor(_Record):
    """`copyreg._reconstructor(class, object, None)`, which protocols 0 and 1 make objects by."""

    def __new__(cls, made, base, state):
        if not (isinstance(made, type) and issubclass(made, (_Chumpy, _Sparse))):
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
    _ALLOWED |= {f"{_builtins}:{name}": list for name in ("set", "frozenset")}
    _ALLOWED |= {f"{_builtins}:object": _Record, f"{_builtins}:bytes": _Bytes}
for _numpy in ("numpy.core", "numpy._core"):
    _ALLOWED |= {
        f"{_numpy}.multiarray:_reconstruct": _Array,
        f"{_numpy}.multiarray:scalar": _Scalar,
        f"{_numpy}.numeric:_frombuffer": _ArrayOfBuffer,
    }


def _load_tuple(n: int):
    def load(unpickler):
        unpickler.stack[-n:] = [unpickler.stack[-n:]]

    return load


class _Unpickler(pickle._Unpickler):
    """The one in Python: that in C allots what a length in the file claims before it reads it.

    Tuples and sets are lists, which cannot be keys: to look for the hash of a deep tuple crashes
    Python, and takes for ever where each holds another twice.
    """

    def find_class(self, module, name):
        if f"{module}:{name}" in _ALLOWED:
            return _ALLOWED[f"{module}:{name}"]
        if module.partition(".")[0] == "chumpy":
            return _Chumpy
        if sparse := _SPARSE.fullmatch(f"{module}:{name}"):
            return _KINDS[sparse[1]]
        raise InputError(
            "must be a pickle of plain arrays. Received one that asks for "
            f"{brief(f'{module}.{name}')}, which could run code; nothing was run."
        )

    _own = pickle._Unpickler
    dispatch = _own.dispatch | {
        pickle.EMPTY_TUPLE[0]: _own.load_empty_list,
        pickle.EMPTY_SET[0]: _own.load_empty_list,
        pickle.TUPLE1[0]: _load_tuple(1),
        pickle.TUPLE2[0]: _load_tuple(2),
        pickle.TUPLE3[0]: _load_tuple(3),
        pickle.TUPLE[0]: _own.load_list,
        pickle.FROZENSET[0]: _own.load_list,
        pickle.ADDITEMS[0]: _own.load_appends,
        pickle.BYTEARRAY8[0]: _own.load_binbytes8,
    }


def _resolve(value: object, seen: dict):
    """The same data with every record replaced by what it stands for, each once."""
    if isinstance(value, type):
        raise InputError("must hold data only. Received a bare name.")
    if not isinstance(value, (list, dict, _Record)):
        return value
    if id(value) not in seen:
        if isinstance(value, _Record):
            found = value.value(seen)
        elif isinstance(value, dict):
            found = {_resolve(key, seen): _resolve(item, seen) for key, item in value.items()}
        else:
            found = [_resolve(item, seen) for item in value]
        seen[id(value)] = found
    return seen[id(value)]


def _array(raw, dtype, shape, order: str, seen: dict) -> np.ndarray:
    dtype = _resolve(dtype, seen)
    if isinstance(raw, str):
        raw = raw.encode("latin1")  # Python 2 wrote bytes as text
    if len(raw) != math.prod(shape) * dtype.itemsize:
        raise ValueError(f"an array {shape} of {dtype} with {len(raw)} bytes")
    array = np.frombuffer(raw, dtype).reshape(shape, order=order)
    return array.astype(dtype.newbyteorder("="), order="C")


def _integers(array: np.ndarray) -> np.ndarray:
    if array.dtype.kind not in "iu":
        raise ValueError(f"a sparse matrix with indices of type {array.dtype}")
    return array
