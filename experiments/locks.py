"""Locks of folders, so that two commands do not write to one at once."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from deepmds_keras.io.errors import InputError


@contextmanager
def locked(folder: Path, *, wait: bool = False) -> Iterator[None]:
    """Hold a folder's lock; the system frees it when the process ends, however it ends.

    Args:
        folder: Made if missing; the lock is its file `.lock`.
        wait: Whether to wait for another process that holds it.

    Raises:
        InputError: Another process holds it, and `wait` is false.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / ".lock", "w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if not wait:
                raise InputError(
                    f"{folder} is in use by another run; wait for it or choose another --build."
                ) from None
            print(f"  another run writes to {folder}; waiting for it", flush=True)
            fcntl.flock(file, fcntl.LOCK_EX)
        yield
