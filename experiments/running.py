"""Life of a stage: under a lock, with a record, to its end or to one line of what is wrong."""

from __future__ import annotations

import datetime
import errno
import logging
import os
import resource
import shlex
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

from filelock import FileLock, Timeout
from threadpoolctl import threadpool_limits

from deepmds_keras.io.errors import InputError
from experiments.build_key import check_key, inputs_of, needs_of
from experiments.records import with_checksum, write_json
from experiments.run import Run

# Sums of gradients are split between the threads: a network depends on their number.
_TENSORFLOW_THREADS = "2"
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_FORBIDDEN = (errno.EACCES, errno.EROFS, errno.EIO, errno.ENOTDIR)


@contextmanager
def stage(run: Run, name: str) -> Iterator[dict]:
    """Run one stage under the lock of the run's folder and record it in `<name>.json`.

    The record is written last, so that it stands for a stage that is complete. A file or argument
    that cannot be used, or a disk that is full, ends the process with one line and status 2. What a
    stage that was killed had half written is deleted. A stage that scores waits for others that
    write results of the same model, since some files are of them all.

    Args:
        run: The run.
        name: Of the stage, one of those of the run's track in `experiments.stages`.

    Yields:
        A dict for what else the record is to say; `processes_mb`, the peak memory of each process
        that the stage started, is added to its own.
    """
    record: dict = {}
    started, clock = datetime.datetime.now(datetime.timezone.utc), time.perf_counter()
    quiet_tensorflow()
    os.environ["TF_NUM_INTRAOP_THREADS"] = _TENSORFLOW_THREADS
    path = run.record_file(name)
    print(f"— {path.stem}: {run.model}, {run.preset.name} preset, seed {run.seed}", flush=True)
    turn = locked(run.model_results, wait=True) if name == run.track else nullcontext()
    with exit_on_user_error(), locked(run.work), turn:
        for left_behind in run.work.rglob(".*.partial"):
            left_behind.unlink(missing_ok=True)
        check_key(run, name, write=True)
        origin = {"needs": needs_of(run, name), "inputs": inputs_of(run, name)}
        yield record
        record |= {
            "build": run.work.name,
            "stage": path.stem,
            "command": "python -m experiments " + shlex.join(sys.argv[1:]),
            "started": started.isoformat(timespec="seconds"),
            "seconds": round(time.perf_counter() - clock, 1),
            "peak_memory_mb": peak_memory_mb() + sum(record.get("processes_mb", ())),
            **origin,
        }
        write_json(path, with_checksum(record))
    print(f"  {record['seconds']} s, {record['peak_memory_mb']} MB at most", flush=True)


@contextmanager
def exit_on_user_error() -> Iterator[None]:
    """End with one line and status 2 on a file or argument that cannot be used, or a full disk."""
    try:
        yield
    except InputError as error:
        reason = str(error)
    except OSError as error:
        if error.errno not in (*_FULL, *_FORBIDDEN):
            raise
        reason = f"{error.filename or 'A file'}: {error.strerror}."
        if error.errno in _FULL:
            reason += " Free some space and run again; what is complete is kept."
    else:
        return
    print(f"error: {reason}", file=sys.stderr)
    raise SystemExit(2)


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


@contextmanager
def single_threaded() -> Iterator[None]:
    """Compute and draw with one thread: a process per core, sums in one order anywhere."""
    os.environ.setdefault("LP_NUM_THREADS", "1")  # of Mesa's software renderer
    with threadpool_limits(1):
        yield


def call_single_threaded(function: Callable, *arguments):
    """Call a function in `single_threaded`, as a task of another process."""
    with single_threaded():
        return function(*arguments)


def quiet_tensorflow() -> None:
    """Each network of a stage is traced once, which TensorFlow takes for one traced too often."""
    logging.getLogger("tensorflow").setLevel(logging.ERROR)


def peak_memory_mb() -> int:
    """Largest resident set of this process, or of a child that has ended."""
    unit = 1 if sys.platform == "darwin" else 1024
    usage = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return round(max(u.ru_maxrss for u in usage) * unit / 1e6)
