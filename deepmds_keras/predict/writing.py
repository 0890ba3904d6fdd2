"""Writes files whole or not at all."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from deepmds_keras import files
from deepmds_keras.errors import InputError


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a file as `new_file` does, and raise as it does."""
    with new_file(path) as file:
        file.write(content)


@contextmanager
def new_file(path: str | Path) -> Iterator[BinaryIO]:
    """Open a file to write to, under a temporary name until it is complete; its folder is made.

    Raises:
        InputError: It cannot be written.
    """
    try:
        with files.atomic_write(path) as file:
            yield file
    except OSError as error:
        raise InputError(
            f"{path} must be a file that can be written. Received: {error.strerror}."
        ) from None
