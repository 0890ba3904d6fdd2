"""`python -m experiments STEP [ITEM …] [options]`: run one step, as `experiments/Snakefile` does.

A step is a module of this package with `main(run, *items)`, such as `datasets.faces`.
"""

import datetime
import errno
import json
import logging
import os
import platform
import resource
import shlex
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from importlib.util import find_spec
from inspect import signature
from pathlib import Path

from threadpoolctl import threadpool_limits

from deepmds_keras.errors import InputError, escape_unprintable
from deepmds_keras.files import sha256_of
from experiments.methods import METHODS
from experiments.progress import PARENT, Progress
from experiments.progress.step_names import in_words
from experiments.records import (
    environment,
    publish,
    write_manifest,
    write_record,
    writers,
)
from experiments.run import OPTIONS, Parser, Run, add_options, run_of

# Sums are split between threads: their last digits depend on this number, not on the machine's.
_THREADS = 2
# Several of these, or of their tasks, run at once, each with one thread: more would wait for each
# other.
_SIDE_BY_SIDE = (
    *("tracks.train", "lifting.train", "lifting.train_pairs", "pretrained.train", "objects.train"),
    *("studies.variant", "studies.scale", "studies.stream_part", "released_weights.train"),
    *("lifting.hard", "lifting.transfer"),
)
_XLA = "--xla_cpu_max_isa=AVX2"
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_FORBIDDEN = (errno.EACCES, errno.EROFS, errno.EIO, errno.ENOTDIR)


def main(arguments: list[str] | None = None) -> None:
    parser = Parser("python -m experiments", description=__doc__)
    parser.add_argument("step", help="module, such as datasets.faces")
    parser.add_argument("items", nargs="*", help="which items, for a step that runs once per item")
    parser.add_argument("--record", type=Path, help="file to write the step's record to")
    parser.add_argument("--inputs", type=Path, nargs="*", default=[], help="files it is made from")
    add_options(parser)
    values = vars(parser.parse_intermixed_args(arguments))
    signal.signal(signal.SIGTERM, _end)
    with one_line_errors():
        run = run_of(values)
        module = f"experiments.{values['step']}"
        if not values["step"].islower() or _spec(module) is None:
            raise InputError(
                f"STEP must be a module of experiments, such as datasets.faces. Received {module}."
            )
        onednn = _is_onednn(values["step"], values["items"])
        alone = onednn or values["step"] not in _SIDE_BY_SIDE
        prepare(onednn=onednn, threads=_THREADS if alone else 1)
        end_with_parent()
        Progress.step = in_words(values["record"]) if values["record"] else values["step"]
        _run_step(module, run, values)
        sys.stdout.flush()


def _end(*_) -> None:
    """Exit with clean-up. A library that this interrupts as it is loaded may abort, with a text."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    sys.exit(128 + signal.SIGTERM)


def _spec(module: str):
    with suppress(ModuleNotFoundError):
        return find_spec(module)
    return None


def _step(module: str, *arguments):
    """`main` of a module that takes such arguments."""
    step = getattr(import_module(module), "main", None)
    try:
        signature(step).bind(*arguments)
    except TypeError as error:
        reason = f"{module} must be a step that takes these items. Received: {error}."
        raise InputError(reason) from None
    return step


def _run_step(module: str, run: Run, values: dict) -> None:
    """Run a step, then write its record, and put its results with their manifests in place."""
    started, clock = datetime.datetime.now(datetime.UTC), time.perf_counter()
    machine = environment()  # before the step, lest a commit made meanwhile is taken for its code
    step = _step(module, run, *values["items"])
    try:
        outcome = step(run, *values["items"]) or {}
    except (InputError, FileNotFoundError) as error:
        reason = str(error) if isinstance(error, InputError) else f"{error.filename} not found."
        if not (found := writers(reason, run.build / run.model)):
            raise
        # To delete the record does not do: Snakemake skips it where what needs it is there.
        again = f"The same command with SNAKEMAKE='--forcerun {found[0]}' writes it again."
        raise InputError(f"{reason} {again}") from None
    records = [path for path in values["inputs"] if path.parent.name == "records"]
    outside = [p for p in values["inputs"] if not {run.build, run.results} & {*p.parents}]
    folders = [Path(folder) for folder in outcome.pop("results", ())]
    record = {
        "name": values["record"].stem if values["record"] else values["step"],
        "step": " ".join([values["step"], *values["items"]]),
        "command": os.environ.get("EXPERIMENTS_COMMAND")
        or "python -m experiments " + shlex.join(sys.argv[1:]),
        "options": {k: v for k in OPTIONS if (v := values[k]) not in (None, "") and k != "jobs"},
        "preset": vars(run.preset),
        "started": started.isoformat(timespec="seconds"),
        "seconds": round(time.perf_counter() - clock, 1),
        "peak_memory_mb": peak_memory_mb(),
        **machine,
        "inputs": {path.name: sha256_of([path]) for path in outside},
        "needs": [str(path) for path in dict.fromkeys(records)],
        **outcome,
    }
    record = json.loads(json.dumps(record))  # as it will be read
    for folder in folders:
        write_manifest(folder, record)
    if values["record"] is not None:
        write_record(values["record"], record)
    # Last, and not to be interrupted: Snakemake restores old results where a step has failed.
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    for folder in folders:
        publish(folder)


def _is_onednn(step: str, items: list[str]) -> bool:
    """Whether a step trains or runs a method whose convolutions are oneDNN's, or times all."""
    of_method = step in ("tracks.train", "tracks.predict") and items and items[0] in METHODS
    return step == "tracks.times" or bool(of_method) and METHODS[items[0]].onednn


def prepare(*, onednn: bool = False, threads: int = _THREADS) -> None:
    """Set what numbers depend on, before TensorFlow reads it, and silence its notices."""
    os.environ["TF_ENABLE_ONEDNN_OPTS"] = str(int(onednn))
    # Compiled code is the same whatever the processor offers beyond AVX2.
    flags = os.environ.get("XLA_FLAGS", "")
    if _XLA not in flags:
        os.environ["XLA_FLAGS"] = f"{_XLA} {flags}".strip()
    os.environ["TF_NUM_INTRAOP_THREADS"] = str(threads)
    os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = str(threads)
    threadpool_limits(threads)  # of libraries that are loaded already
    # From a pool: the allocator of C returns the megabytes of a training step, to be cleared anew
    # for the next one. Wide nets on pairs of landmarks took twice as long.
    os.environ["TF_CPU_ALLOCATOR_USE_BFC"] = "true"
    os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"
    # Each network of a step is traced once, which TensorFlow takes for one traced too often.
    logging.getLogger("tensorflow").setLevel(logging.ERROR)
    if onednn:
        # TensorFlow prints a notice about oneDNN before it reads the log level.
        with _silent_stderr():
            import_module("tensorflow")


@contextmanager
def _silent_stderr() -> Iterator[None]:
    """Drop what is written to standard error, also by compiled code."""
    kept, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(null)


def end_with_parent() -> None:
    """End this process when that of `make` ends, for whatever reason.

    Not on another machine: clusters hand the variables of `make` on to their jobs.
    """
    parent, _, machine = os.environ.get(PARENT, "").partition("@")

    def watch() -> None:
        while True:
            try:
                os.kill(int(parent), 0)
            except ProcessLookupError:
                os._exit(128 + signal.SIGTERM)
            time.sleep(0.5)

    if parent and machine == platform.node():
        threading.Thread(target=watch, daemon=True).start()


@contextmanager
def one_line_errors() -> Iterator[None]:
    """End with one line and status 2 on a file or argument that cannot be used, or a full disk.

    Characters that the terminal lacks are no error; they are escaped.
    """
    escape_unprintable()
    try:
        yield
        return
    except InputError as error:
        reason = str(error)
    except OSError as error:
        if isinstance(error, BrokenPipeError):  # the reader of the output, such as `head`, is gone
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise SystemExit(128 + signal.SIGPIPE) from None
        if error.errno not in (*_FULL, *_FORBIDDEN):
            raise
        reason = f"{error.filename or 'A file'}: {error.strerror}."
        if error.errno in _FULL:
            reason += " Free some space and run again; what is complete is kept."
    except KeyboardInterrupt:
        raise SystemExit(128 + signal.SIGINT) from None
    print(f"error: {reason}", file=sys.stderr)
    raise SystemExit(2)


def peak_memory_mb() -> int:
    """Largest resident set of this process, or of a child that has ended."""
    unit = 1 if sys.platform == "darwin" else 1024
    usage = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return round(max(u.ru_maxrss for u in usage) * unit / 1e6)


if __name__ == "__main__":
    try:
        main()
    finally:  # nothing is left to be cleaned up
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
