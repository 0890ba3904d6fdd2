"""Files that appear whole or not at all."""

from __future__ import annotations

import errno
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from deepmds_keras.io.errors import InputError

_LONGEST = (
    32  # of a file's name in that of its temporary one, lest this is longer than names may be
)


@contextmanager
def atomic_write(path: str | Path) -> Iterator[BinaryIO]:
    """Open a file to write to, under a temporary name until it is complete; its folder is made.

    Raises:
        InputError: The path is that of a folder.
        OSError: It cannot be written; `filename` is the path.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path} must be a file to write. Received a folder.")
    partial = path.with_name(f".{path.name[:_LONGEST]}.{secrets.token_hex(4)}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(partial, "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())  # some file systems only tell here that they are full
        os.replace(partial, path)
    except OSError as error:
        number = error.errno or errno.ENOSPC  # NumPy has none for what it could not write
        raise OSError(number, os.strerror(number), str(path)) from error
    finally:
        with suppress(OSError):  # there is none when all went well
            partial.unlink()


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a file as `atomic_write` does, and raise as it does."""
    with atomic_write(path) as file:
        file.write(content)
