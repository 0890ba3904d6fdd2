"""Writes files whole or not at all."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from deepmds_keras.io.errors import InputError


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a file, under a temporary name until it is complete; its folder is made if missing.

    Raises:
        InputError: It cannot be written.
    """
    path = Path(path)
    # Of a long name the beginning, lest the temporary one is longer than names may be.
    partial = path.with_name(f".{path.name[:32]}.{os.getpid()}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(content)
        os.replace(partial, path)
    except OSError as error:
        raise InputError(
            f"{path} must be a file that can be written. Received: {error.strerror}."
        ) from None
    finally:
        with contextlib.suppress(OSError):  # there is none when all went well
            partial.unlink()
