"""What befalls real runs, done to stages on purpose: no space, sudden ends, company, few threads.

`Storm` takes the stages of an experiment through all of it, in one folder. Wherever a stage was
stopped, running it again must end with the same tables as a run that nothing disturbed.
"""

from __future__ import annotations

import csv
import functools
import hashlib
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
# `make` sets the same; a stage that runs alone is as deterministic as its threads.
ENVIRONMENT = os.environ | {"TF_CPP_MIN_LOG_LEVEL": "3", "TF_ENABLE_ONEDNN_OPTS": "0"}
ONE_THREAD = {
    name: "1"
    for name in (
        *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"),
        *("TF_NUM_INTRAOP_THREADS", "TF_NUM_INTEROP_THREADS"),
    )
}
STAGES = ("faces", "networks", "predictions", "images", "mobileface", "bfm")
LONG = ("networks", "ablation", "photos", "ringnet")  # at work before a second one has started
_PAGE = os.sysconf("SC_PAGE_SIZE")
_EARLIEST = 0.2  # share of a stage's time in which it only starts


def command(stage: str, folder: Path, *more: str) -> list[str]:
    """A stage at the smallest size, with `build` and `results` in a folder."""
    return [
        sys.executable, "-m", "experiments", stage, "--preset", "smoke",
        "--build", str(folder / "build"), "--results", str(folder / "results"), *more,
    ]  # fmt: skip


def run(
    stage: str, folder: Path, *more: str, threads: dict[str, str] | None = None
) -> subprocess.CompletedProcess:
    return subprocess.run(
        command(stage, folder, *more),
        cwd=ROOT, env=ENVIRONMENT | (threads or {}), capture_output=True, text=True,
    )  # fmt: skip


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
        done = run(stage, folder, *more)
        assert done.returncode == 0, done.stderr
        seconds[stage] = time.perf_counter() - start
        sizes[stage] = {
            path.relative_to(folder): path.stat().st_size
            for path, stamp in _stamps(folder).items()
            if before.get(path) != stamp
        }
    return Measured(folder, seconds, sizes)


@dataclass(frozen=True)
class Event:
    """What was done to a stage, and how it ended.

    Attributes:
        what: `"full disk"`, `"killed"`, `"killed alone"` (its processes live on), `"refused"` (for
            another was at work) or `"done"`.
        stage: The stage.
        status: Of the process; negative for the signal that ended it.
        said: Its standard error.
        changed: Files, by their names in the folder, that are gone or of other bytes since.
        added: Files that are there for the first time.
    """

    what: str
    stage: str
    status: int
    said: str
    changed: frozenset[Path]
    added: frozenset[Path]


class Disk:
    """A folder that can be full: a tmpfs where one may be mounted, else a limit to each file."""

    def __init__(self, folder: Path):
        self.folder, self.limit = folder, None
        folder.mkdir()
        mount = ["mount", "-t", "tmpfs", "-o", "size=1g", "tmpfs", str(folder)]
        try:
            self.mounted = subprocess.run(mount, capture_output=True).returncode == 0
        except OSError:  # no such command
            self.mounted = False

    def leave(self, share: float, sizes: Sequence[int]) -> None:
        """Leave room for less than a share of files of these sizes."""
        if self.mounted:
            disk = os.statvfs(self.folder)
            used = (disk.f_blocks - disk.f_bfree) * disk.f_frsize
            pages = int(share * sum(-(-size // _PAGE) for size in sizes))
            self._resize(used + pages * _PAGE)
        else:
            self.limit = int(share * max(sizes))

    def clear(self) -> None:
        """Leave room for anything."""
        self.limit = None
        if self.mounted:
            self._resize(1 << 30)

    def close(self) -> None:
        if self.mounted:
            subprocess.run(["umount", "--lazy", str(self.folder)], check=True)

    def _resize(self, size: int) -> None:
        subprocess.run(["mount", "-o", f"remount,size={size}", str(self.folder)], check=True)


class Storm:
    """Stages that are starved and killed at random, and run to their end.

    Args:
        reference: The same stages, undisturbed.
        disk: Where they write.
        rng: Draws the moments.
        more: Arguments of every stage.
    """

    def __init__(
        self, reference: Measured, disk: Disk, rng: np.random.Generator, more: Sequence[str] = ()
    ):
        self.reference, self.disk, self.rng, self.more = reference, disk, rng, more
        self.folder = disk.folder
        self.events: list[Event] = []
        self._groups: list[int] = []

    def pass_over(self, stages: Sequence[str], kills: int, threads: dict[str, str]) -> None:
        """Kill stages, `kills` times in all and the longest first; starve and finish each."""
        longest = sorted(stages, key=self.reference.seconds.get, reverse=True)
        for stage in stages:
            for _ in range(longest.index(stage), kills, len(stages)):
                self.kill(stage)
            self.starve(stage)
            self.finish(stage, threads)
        for group in self._groups:  # a process whose parent was killed ends by itself, but later
            _kill_group(group)

    def starve(self, stage: str) -> None:
        """Run a stage with too little room for what it has yet to write."""
        sizes = self.reference.sizes[stage].items()
        if all((self.folder / name).exists() for name, _ in sizes):
            self._undo(stage)
        missing = [size for name, size in sizes if not (self.folder / name).exists()]
        self.disk.leave(self.rng.uniform(0, 0.9), missing)
        before = _digests(self.folder)
        self._ended("full disk", stage, self._start(stage), before)
        self.disk.clear()

    def kill(self, stage: str) -> None:
        """Kill a stage at a random moment, an earlier one as long as it was faster."""
        # Every third without its own processes, as the system does when memory is short.
        alone = sum(event.what.startswith("killed") for event in self.events) % 3 == 2
        longest = self.reference.seconds[stage]
        while True:
            before, start = _digests(self.folder), time.perf_counter()
            process = self._start(stage)
            try:
                process.wait(longest * self.rng.uniform(_EARLIEST, 1))
            except subprocess.TimeoutExpired:
                process.kill() if alone else _kill_group(process.pid)
                if process.wait() != 0:  # not at its end in that very moment
                    self._ended("killed alone" if alone else "killed", stage, process, before)
                    return
            longest = time.perf_counter() - start
            self._ended("done", stage, process, before)
            self._undo(stage)  # for the next one to have work

    def finish(self, stage: str, threads: dict[str, str]) -> None:
        """Run a stage to its end; a long one together with a second, which is to give way."""
        before = _digests(self.folder)
        more = ("--jobs", "1") if threads else ()
        processes = [self._start(stage, *more, threads=threads)]
        if stage in LONG:
            processes.append(self._start(stage))
        said = [process.communicate()[1] for process in processes]
        for process, words in sorted(
            zip(processes, said, strict=True), key=lambda pair: -pair[0].returncode
        ):
            what = "refused" if process.returncode == 2 else "done"
            self._ended(what, stage, process, before, words)

    def _undo(self, stage: str) -> None:
        """Delete what a stage wrote."""
        for name in self.reference.sizes[stage]:
            (self.folder / name).unlink(missing_ok=True)

    def _start(self, stage: str, *more: str, threads: dict[str, str] | None = None):
        limit = self.disk.limit
        limit_files = None if limit is None else functools.partial(
            resource.setrlimit, resource.RLIMIT_FSIZE, (limit, limit)
        )  # fmt: skip
        process = subprocess.Popen(
            command(stage, self.folder, *self.more, *more),
            cwd=ROOT,
            # On another disk, since it stays behind where every process of a stage is killed.
            env=ENVIRONMENT | {"JOBLIB_TEMP_FOLDER": str(self.folder.parent)} | (threads or {}),
            start_new_session=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
            preexec_fn=limit_files,
        )  # fmt: skip
        self._groups.append(process.pid)
        return process

    def _ended(self, what: str, stage: str, process, before: dict, said: str | None = None) -> None:
        if said is None:
            # Not to its end: processes whose parent was killed alone have it open for longer.
            said = "" if what == "killed alone" else process.communicate()[1]
        process.stderr.close()
        after = _digests(self.folder)
        changed = frozenset(path for path, digest in before.items() if after.get(path) != digest)
        added = frozenset(after.keys() - before.keys())
        self.events.append(Event(what, stage, process.wait(), said, changed, added))


def tables(folder: Path) -> dict[str, list[list[str]]]:
    """Every CSV of the results, cell by cell, without what tells how long something took."""
    found = {}
    for path in sorted((folder / "results").rglob("*.csv")):
        with open(path, encoding="utf-8", newline="") as file:
            header, *rows = csv.reader(file)
        columns = [k for k, name in enumerate(header) if name != "ms_per_face"]
        found[str(path.relative_to(folder))] = [
            [row[k] for k in columns] for row in (header, *rows) if "ms_per_face" not in row[:2]
        ]
    return found


def same(first, second) -> bool:
    """Whether two values read from files are the same to the last bit."""
    if isinstance(first, dict):
        return first.keys() == second.keys() and all(same(first[k], second[k]) for k in first)
    if isinstance(first, tuple):
        return all(map(same, first, second))
    if isinstance(first, np.ndarray):
        kinds = (first.dtype, first.shape) == (second.dtype, second.shape)
        return kinds and first.tobytes() == second.tobytes()
    return first == second


def flips(content: bytes, n: int, rng: np.random.Generator) -> list[tuple[int, int]]:
    """Where to change a byte, and by which bits: half of them in the file's head and its end."""
    size = len(content)
    anywhere = rng.integers(0, size, n - n // 2)
    head = rng.integers(0, min(size, 256), n // 4)
    end = size - 1 - rng.integers(0, min(size, 2048), n // 2 - n // 4)
    positions = np.concatenate([anywhere, head, end])
    return [*zip(positions.tolist(), rng.integers(1, 256, n).tolist(), strict=True)]


def _files(folder: Path) -> list[Path]:
    """Files but those with temporary names, the locks among them."""
    return [path for path in folder.rglob("[!.]*") if path.is_file()]


def _stamps(folder: Path) -> dict[Path, tuple[int, int]]:
    return {path: (path.stat().st_mtime_ns, path.stat().st_size) for path in _files(folder)}


def _digests(folder: Path) -> dict[Path, str]:
    return {
        path.relative_to(folder): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in _files(folder)
    }


def _kill_group(group: int) -> None:
    try:
        os.killpg(group, signal.SIGKILL)
    except ProcessLookupError:
        return
