"""Arrays in NumPy's files, of which nothing is executed and no header is believed."""

from __future__ import annotations

import json
import math
import os
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from deepmds_keras.io.atomic import atomic_write
from deepmds_keras.io.errors import InputError, brief

_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
# The most that a byte of a member can stand for. What savez does not write is refused.
_EXPANSION = {zipfile.ZIP_STORED: 1, zipfile.ZIP_DEFLATED: 1032}
_ZIP_END, _ZIP_END_SIZE = b"PK\5\6", 22


def write_arrays(
    path: str | Path,
    arrays: dict[str, np.ndarray],
    description: dict,
    *,
    compressed: bool = True,
) -> None:
    """Write arrays and a JSON description into one npz, complete or not at all.

    Raises:
        InputError, OSError: As for `atomic_write`.
    """
    save = np.savez_compressed if compressed else np.savez
    with atomic_write(path) as file:
        save(file, description=np.array(json.dumps(description)), **arrays)


def read_arrays(
    path: str | Path, kind: str = "an npz written by save()"
) -> tuple[dict[str, np.ndarray], dict]:
    """Read what `write_arrays` wrote.

    Raises:
        InputError: The file is missing, damaged or not of this kind.
    """
    arrays = read_npz(path, kind)
    with _named(path, kind):
        description = json.loads(str(arrays.pop("description")))
        if not isinstance(description, dict):
            raise ValueError("a description that is no dict")
    return arrays, description


def read_npz(path: str | Path, kind: str = "an npz file of plain arrays") -> dict[str, np.ndarray]:
    """Return all arrays of an npz by name.

    NumPy allots what a header claims before it finds out that the file is shorter; here the two
    are compared first.

    Args:
        path: The file.
        kind: Its kind with an article, for the message.

    Raises:
        InputError: The file is missing, damaged or foreign, or holds anything but plain arrays.
    """
    with _named(path, kind), open(path, "rb") as file, zipfile.ZipFile(file) as archive:
        size = file.seek(0, os.SEEK_END)
        arrays = {
            member.filename.removesuffix(".npy"): _read_member(archive, member, size)
            for member in archive.infolist()
        }
        _check_number(file, len(arrays))
    return arrays


def map_npy(path: str | Path, kind: str = "one array in NumPy's format") -> np.ndarray:
    """Return the array of an npy file, read-only; only the pages that are asked for are read.

    Raises:
        InputError: As `read_npz`.
    """
    with _named(path, kind):  # mapped, a header cannot claim more memory than the file has
        return np.lib.format.open_memmap(path, mode="r")


@contextmanager
def _named(path: str | Path, kind: str) -> Iterator[None]:
    """Make one line of whatever goes wrong, which names the file."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python's of odd headers, NumPy's of those of Python 2
            yield
    except FileNotFoundError:
        raise InputError(f"{path} does not exist; it must be {kind}.") from None
    except Exception as error:  # zipfile, zlib and NumPy's parser of headers raise many kinds
        received = f"{type(error).__name__}: {brief(error)}"
        if isinstance(error, OSError) and error.strerror:
            received = error.strerror
        elif "allow_pickle" in str(error):  # NumPy's advice, not to be followed
            received = "an array of objects, which can run code when read"
        raise InputError(f"{path} must be {kind}. Received {received}.") from None


def _read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, size: int) -> np.ndarray:
    """Read an array of an npz file of `size` bytes."""
    if member.compress_type not in _EXPANSION or member.compress_size > size:
        raise ValueError(f"{member.filename} is packed in another way than NumPy packs")
    with archive.open(member) as stream:
        shape, _, dtype = _HEADERS[np.lib.format.read_magic(stream)](stream)
    n_bytes = math.prod(shape) * dtype.itemsize
    if n_bytes > member.compress_size * _EXPANSION[member.compress_type] and not dtype.hasobject:
        raise ValueError(f"{member.filename} claims {n_bytes} bytes, more than the file can hold")
    with archive.open(member) as stream:
        return np.lib.format.read_array(stream, allow_pickle=False)


def _check_number(file: BinaryIO, n: int) -> None:
    """Python reads a damaged list of contents up to the damage, and does not count what it read."""
    file.seek(-_ZIP_END_SIZE, os.SEEK_END)
    end = file.read()
    if end.startswith(_ZIP_END) and n != int.from_bytes(end[10:12], "little"):
        raise ValueError(f"{n} arrays of {int.from_bytes(end[10:12], 'little')}")
