"""Files that appear whole or not at all, arrays in NumPy's files, tables and checksums."""

import csv
import errno
import hashlib
import io
import json
import os
import secrets
import zipfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

import numpy as np

from deepmds_keras.errors import InputError, brief

_ZIP_END_SIZE = 22
_TRIES = 5
_LONGEST_NAME = 32  # characters of a file's name in that of its temporary one: names have a limit


def instead_of_file(path: Path) -> str:
    """What is at a path where no file is, for messages."""
    return "a folder or device" if path.exists() else "a path that does not exist"


@contextmanager
def atomic_write(path: str | Path) -> Iterator[BinaryIO]:
    """Open a file for writing, under a temporary name until it is complete; create its folder.

    Raises:
        InputError: The path is a folder.
        OSError: The file cannot be written; `filename` is the path.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path} must be a file to write. Received a folder.")
    partial = path.with_name(f".{path.name[:_LONGEST_NAME]}.{secrets.token_hex(4)}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(partial, "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())  # some file systems report only here that they are full
        os.replace(partial, path)
    except OSError as error:
        number, cause = error.errno or errno.EIO, error.strerror or brief(error)
        if "requested and" in cause:  # NumPy's words for a short write, without a number
            number, cause = errno.ENOSPC, os.strerror(errno.ENOSPC)
        raise OSError(number, cause, str(path)) from error
    finally:
        with suppress(OSError):  # there is none when all went well
            partial.unlink()


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a file as `atomic_write` does, and raise as it does."""
    with atomic_write(path) as file:
        file.write(content)


def write_arrays(
    path: str | Path, arrays: dict[str, np.ndarray], description: dict, *, compressed: bool = True
) -> None:
    """Write arrays and a JSON description into one npz, and raise as `atomic_write` does."""
    save: Callable[..., None] = np.savez_compressed if compressed else np.savez
    text = json.dumps(description, default=lambda number: number.item())  # NumPy's numbers
    with atomic_write(path) as file:
        save(file, description=np.array(text), **arrays)


@contextmanager
def reading(path: str | Path, kind: str) -> Iterator[None]:
    """Context for reading a file: any error becomes one InputError, that it must be `kind`."""
    try:
        yield
    except FileNotFoundError:
        raise InputError(f"{path} does not exist; it must be {kind}.") from None
    except Exception as error:  # zipfile, zlib and NumPy's parser of headers raise many kinds
        received = f"{type(error).__name__}: {brief(error)}"
        if isinstance(error, OSError) and error.strerror:
            received = error.strerror
        # NumPy advises to allow it, or says that no such array can be mapped.
        elif "allow_pickle" in str(error) or "Python objects" in str(error):
            received = "an array of objects, which can run code when read"
        raise InputError(f"{path} must be {kind}. Received {received}.") from None


def read_arrays(
    path: str | Path, kind: str = "an npz written by save()"
) -> tuple[dict[str, np.ndarray], dict]:
    """Read what `write_arrays` wrote.

    Raises:
        InputError: The file is missing, damaged or not of this kind.
    """
    arrays = read_npz(path, kind)
    with reading(path, kind):
        description = json.loads(str(arrays.pop("description")))
        if not isinstance(description, dict):
            raise ValueError("a description that is no dict")
    return arrays, description


def read_npz(path: str | Path, kind: str = "an npz file of plain arrays") -> dict[str, np.ndarray]:
    """Return all arrays of an npz by name; nothing in the file is executed.

    Raises:
        InputError: The file is missing, damaged or foreign, or holds anything but plain arrays;
            the message calls the file `kind`.
    """
    arrays = {}
    with reading(path, kind), open(path, "rb") as file, zipfile.ZipFile(file) as archive:
        for member in archive.infolist():
            # Read to the end, so that the checksum is compared; NumPy stops at the array's end.
            name, content = member.filename.removesuffix(".npy"), archive.read(member)
            arrays[name] = _parsed(_read_array, content)
        # Python reads a damaged directory up to the damage, and does not compare the count.
        file.seek(-_ZIP_END_SIZE, os.SEEK_END)
        end = file.read()
        listed = int.from_bytes(end[10:12], "little")
        if end.startswith(b"PK\5\6") and len(archive.infolist()) != listed:
            raise zipfile.BadZipFile(f"{len(arrays)} arrays of {listed}")
    return arrays


def map_npy(path: str | Path, kind: str = "one array in NumPy's format") -> np.ndarray:
    """Map the array of an npy file, read-only; bad files raise InputError as in `read_npz`."""
    with reading(path, kind):  # mapped: a header cannot claim more memory than the file has
        return _parsed(np.lib.format.open_memmap, path, mode="r")


def _read_array(content: bytes) -> np.ndarray:
    return np.lib.format.read_array(io.BytesIO(content), allow_pickle=False)


def _parsed(read: Callable[..., np.ndarray], *source, **options) -> np.ndarray:
    """What NumPy reads from a source whose header it evaluates, if need be at a further try.

    In threads Python fails to evaluate now and then up to version 3.11.7 (its issue 106905).
    """
    for _ in range(_TRIES):
        with suppress(SystemError):
            return read(*source, **options)
    return read(*source, **options)


def read_table(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV table as dictionaries; lines that begin with `#` are comments.

    Raises:
        InputError: The file cannot be read or is not such a table.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
        return list(csv.DictReader(line for line in lines if not line.startswith("#")))
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{path} must be a table (CSV). Received {brief(error)}.") from None


def sha256_of(paths: Iterable[Path]) -> str:
    """Return the hash of the files' bytes, concatenated."""
    digest = hashlib.sha256()
    for path in paths:
        with path.open("rb") as file:
            hashlib.file_digest(file, lambda: digest)
    return digest.hexdigest()
