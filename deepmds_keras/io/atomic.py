"""Files that appear whole or not at all."""

from __future__ import annotations

import errno
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """A file to write to, under a temporary name until it is complete; its folder is made.

    Raises:
        OSError: It cannot be written; `filename` is the path.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    try:
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
