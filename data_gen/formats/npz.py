"""Arrays in NumPy's files, of which nothing is run and no header is believed."""

from __future__ import annotations

import math
import warnings
import zipfile
from pathlib import Path

import numpy as np

from deepmds_keras.io.errors import brief

_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
# The most that a byte of a member can stand for. What savez does not write is refused.
_EXPANSION = {zipfile.ZIP_STORED: 1, zipfile.ZIP_DEFLATED: 1032}


def read_npz(path: str | Path) -> dict[str, np.ndarray]:
    """All arrays of an npz by name.

    NumPy allots what a header claims before it finds out that the file is shorter; here the two
    are compared first.

    Raises:
        OSError: The file cannot be opened.
        ValueError: It is damaged or foreign, or holds anything but plain arrays; the message tells
            what, on one short line.
    """
    with open(path, "rb") as opened, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Python's of odd headers, NumPy's of those of Python 2
        try:
            with zipfile.ZipFile(opened) as archive:
                size = opened.seek(0, 2)
                return {
                    member.filename.removesuffix(".npy"): _read_member(archive, member, size)
                    for member in archive.infolist()
                }
        except Exception as error:  # zipfile, zlib and NumPy's parser of headers raise many kinds
            raise ValueError(f"{type(error).__name__}: {brief(error)}") from None


def map_npy(path: str | Path) -> np.ndarray:
    """The array of an npy file, read-only; of it only the pages that are asked for are read.

    Raises:
        OSError: The file cannot be opened.
        ValueError: As `read_npz`.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return np.lib.format.open_memmap(path, mode="r")
        except OSError:
            raise
        except Exception as error:
            raise ValueError(f"{type(error).__name__}: {brief(error)}") from None


def _read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, size: int) -> np.ndarray:
    if member.compress_type not in _EXPANSION or member.compress_size > size:
        raise ValueError(f"{member.filename} is packed in another way than NumPy packs")
    with archive.open(member) as stream:
        shape, _, dtype = _HEADERS[np.lib.format.read_magic(stream)](stream)
    n_bytes = math.prod(shape) * dtype.itemsize
    if n_bytes > member.compress_size * _EXPANSION[member.compress_type] and not dtype.hasobject:
        raise ValueError(f"{member.filename} claims {n_bytes} bytes, more than the file can hold")
    with archive.open(member) as stream:
        return np.lib.format.read_array(stream, allow_pickle=False)
