"""Locks of folders, so that two commands do not write to one at once."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

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
    lock = FileLock(folder / ".lock")
    try:
        lock.acquire(timeout=0)
    except Timeout:
        if not wait:
            raise InputError(
                f"{folder} is in use by another run; wait for it or choose another --build."
            ) from None
        print(f"  another run writes to {folder}; waiting for it", flush=True)
        lock.acquire()
    try:
        yield
    finally:
        lock.release()
