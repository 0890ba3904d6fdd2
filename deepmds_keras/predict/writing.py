"""Writes files whole or not at all."""

from __future__ import annotations

from pathlib import Path

from deepmds_keras.io import atomic
from deepmds_keras.io.errors import InputError


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a file, under a temporary name until it is complete; its folder is made if missing.

    Raises:
        InputError: It cannot be written.
    """
    try:
        atomic.write_bytes(path, content)
    except OSError as error:
        raise InputError(
            f"{path} must be a file that can be written. Received: {error.strerror}."
        ) from None
