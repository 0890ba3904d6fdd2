"""Stages of the experiments at the smallest size, each as a process of its own.

To load TensorFlow takes longer than what such a stage does. Hence they are forked from a process
that has loaded it, but for those that render, which refuse to where it is.
"""

from __future__ import annotations

import atexit
import multiprocessing
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from places import ROOT

PRESET = "tiny"
# As `make` has them: what is compiled is the same on processors with more instructions.
SUMS = {"TF_ENABLE_ONEDNN_OPTS": "0", "XLA_FLAGS": "--xla_cpu_max_isa=AVX2"}
# A stage that runs alone is as deterministic as its threads.
ENVIRONMENT = os.environ | SUMS | {"TF_CPP_MIN_LOG_LEVEL": "3"}
_RENDERING = {"images", "scans", "rings", "photos", "celeba", "portraits"}
_LIBRARIES = (
    "tensorflow", "keras", "h5py", "pandas", "joblib", "sklearn.manifold", "sklearn.linear_model",
    "scipy.stats", "matplotlib.pyplot", "PIL.Image",
)  # fmt: skip
_context = multiprocessing.get_context("forkserver")
_context.set_forkserver_preload([*_LIBRARIES])


@dataclass(frozen=True)
class Done:
    """A stage that has ended, as `subprocess.CompletedProcess`; negative of a signal's number."""

    returncode: int
    stdout: str
    stderr: str


def arguments(stage: str, folder: Path, *more: str) -> list[str]:
    """Of `python -m experiments`, with `build` and `results` in a folder."""
    where = ("--build", str(folder / "build"), "--results", str(folder / "results"))
    return [stage, "--preset", PRESET, *where, *more]


def run(stage: str, folder: Path, *more: str) -> Done:
    """Run a stage to its end."""
    return Stage(stage, folder, *more).done()


def succeed(stage: str, folder: Path, *more: str) -> str:
    """Run a stage that is to succeed, and return what it printed."""
    done = run(stage, folder, *more)
    assert done.returncode == 0, done.stderr
    return done.stdout


def results(folder: Path, name: str, preset: str = PRESET) -> Path:
    """Folder of the tables and figures of that name."""
    return folder / "results" / preset / "openhead" / name


def work(folder: Path, track: str, preset: str = PRESET) -> Path:
    """Folder of the arrays and weights of a track."""
    return folder / "build" / "openhead" / f"{track}-{preset}-paper-seed0"


def copy_build(source: Path, target: Path) -> Path:
    """Copy `build` into another folder; RingNet's 300 MB are the same file there.

    Returns:
        The other folder.
    """

    def copy(path: str, copied: str) -> str:
        # No stage changes a file: what is new takes its place.
        return (os.link if Path(path).name == "ringnet.npz" else shutil.copy2)(path, copied)

    shutil.copytree(source / "build", target / "build", copy_function=copy)
    return target


@dataclass(frozen=True)
class Measured:
    """A run that nothing disturbed.

    Attributes:
        folder: Of its `build` and `results`.
        seconds: How long each stage took.
        sizes: Bytes of each file that a stage wrote, by its name in the folder.
    """

    folder: Path
    seconds: dict[str, float]
    sizes: dict[str, dict[Path, int]]


def measure(stages: Sequence[str], folder: Path, *more: str) -> Measured:
    """Run stages one after the other; the numbers are of the last run of each."""
    seconds, sizes = {}, {}
    for stage in stages:
        before, start = _stamps(folder), time.perf_counter()
        succeed(stage, folder, *more)
        seconds[stage] = time.perf_counter() - start
        sizes[stage] = {
            path.relative_to(folder): path.stat().st_size
            for path, stamp in _stamps(folder).items()
            if before.get(path) != stamp
        }
    return Measured(folder, seconds, sizes)


def files_in(folder: Path) -> list[Path]:
    """Files but those with temporary names, the locks among them."""
    return [path for path in folder.rglob("[!.]*") if path.is_file()]


def _stamps(folder: Path) -> dict[Path, tuple[int, int]]:
    return {path: (path.stat().st_mtime_ns, path.stat().st_size) for path in files_in(folder)}


class Stage:
    """A stage at work, in a session of its own that can be killed as one.

    Args:
        stage: Its name.
        folder: Of `build` and `results`.
        more: Further arguments.
        environment: Variables. With these it is not forked, since libraries have read them.
        limit: Bytes that a file may have, or None.
        scratch: Folder for what joblib leaves where all of it is killed, or None.
    """

    def __init__(
        self,
        stage: str,
        folder: Path,
        *more: str,
        environment: Mapping[str, str] | None = None,
        limit: int | None = None,
        scratch: Path | None = None,
    ):
        self.stage = stage
        self._folder = tempfile.TemporaryDirectory(prefix="stage-")
        self._said = [Path(self._folder.name, name) for name in ("stdout", "stderr")]
        own = arguments(stage, folder, *more)
        variables = ENVIRONMENT | (environment or {})
        if scratch is not None:
            variables["JOBLIB_TEMP_FOLDER"] = str(scratch)
        if environment is None and stage not in _RENDERING:
            forked = (own, self._said, limit, variables)
            self._process = _context.Process(target=_fork, args=forked)
            self._process.start()
        else:
            self._process = _Fresh(own, self._said, limit, variables)
        self.pid = self._process.pid

    def wait(self, seconds: float | None = None) -> int | None:
        """Status once it has ended, None if it has not after so many seconds."""
        self._process.join(seconds)
        return self._process.exitcode

    def kill(self, alone: bool = False) -> None:
        """Kill it together with its processes, or alone."""
        if alone or not kill_group(self.pid):
            self._process.kill()

    def done(self) -> Done:
        """Wait for its end."""
        status = self.wait()
        said = [path.read_text("utf-8") if path.exists() else "" for path in self._said]
        self._folder.cleanup()
        return Done(status, *said)


def kill_group(group: int) -> bool:
    """Kill all processes of a group, if there are any."""
    try:
        os.killpg(group, signal.SIGKILL)
    except ProcessLookupError:
        return False
    return True


class _Fresh:
    """A new interpreter, with the methods of `multiprocessing.Process`."""

    def __init__(self, own, said, limit, variables):
        with open(said[0], "w") as output, open(said[1], "w") as errors:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "experiments", *own],
                cwd=ROOT, env=variables, stdout=output, stderr=errors,
                start_new_session=True, preexec_fn=lambda: _limit_files(limit),
            )  # fmt: skip
        self.pid, self.kill = self._process.pid, self._process.kill

    def join(self, seconds=None):
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            return

    @property
    def exitcode(self):
        return self._process.returncode


def _limit_files(limit: int | None) -> None:
    if limit is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))


def _fork(own: list[str], said: list[Path], limit: int | None, variables: dict[str, str]) -> None:
    """Be `python -m experiments`, in a process that was forked for it."""
    os.setsid()
    os.chdir(ROOT)
    os.environ.clear()
    os.environ.update(variables)
    for number, path in enumerate(said, 1):
        file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(file, number)
        os.close(file)
    _limit_files(limit)
    sys.argv = [str(ROOT / "experiments" / "__main__.py"), *own]
    status = 0
    try:
        from experiments.__main__ import main

        main(own)
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
        status = 1
    # As an interpreter ends: joblib's processes are told to end here, and waited for by `atexit`.
    threading._shutdown()
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)
