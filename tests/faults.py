"""What befalls real runs, done to stages on purpose: no space, sudden ends, company, few threads.

`Storm` takes the stages of an experiment through all of it, in one folder. Wherever a stage was
stopped, running it again must end with the same tables as a run that nothing disturbed.
"""

from __future__ import annotations

import csv
import hashlib
import os
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from runs import Measured, Stage, files_in, kill_group

ONE_THREAD = {
    name: "1"
    for name in (
        *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"),
        *("TF_NUM_INTRAOP_THREADS", "TF_NUM_INTEROP_THREADS"),
    )
}
LONG = ("networks", "ablation", "photos", "ringnet")  # at work before a second one has started
_PAGE = os.sysconf("SC_PAGE_SIZE")
_EARLIEST = 0.2  # share of a stage's time in which it only starts


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
            kill_group(group)

    def starve(self, stage: str) -> None:
        """Run a stage with too little room for what it has yet to write."""
        sizes = self.reference.sizes[stage].items()
        if all((self.folder / name).exists() for name, _ in sizes):
            self._undo(stage)
        missing = [size for name, size in sizes if not (self.folder / name).exists()]
        self.disk.leave(self.rng.uniform(0, 0.9), missing)
        before = _digests(self.folder)
        self._ended("full disk", self._start(stage), before)
        self.disk.clear()

    def kill(self, stage: str) -> None:
        """Kill a stage at a random moment, an earlier one as long as it was faster."""
        # Every third without its own processes, as the system does when memory is short.
        alone = sum(event.what.startswith("killed") for event in self.events) % 3 == 2
        longest = self.reference.seconds[stage]
        while True:
            before, start = _digests(self.folder), time.perf_counter()
            process = self._start(stage)
            if process.wait(longest * self.rng.uniform(_EARLIEST, 1)) is None:
                process.kill(alone)
                if process.wait() != 0:  # not at its end in that very moment
                    self._ended("killed alone" if alone else "killed", process, before)
                    return
            longest = time.perf_counter() - start
            self._ended("done", process, before)
            self._undo(stage)  # for the next one to have work

    def finish(self, stage: str, threads: dict[str, str]) -> None:
        """Run a stage to its end; a long one together with a second, which is to give way."""
        before = _digests(self.folder)
        processes = [self._start(stage, *("--jobs", "1") * bool(threads), environment=threads)]
        if stage in LONG:
            # It starts as late as the first, if that one has its libraries to load.
            processes.append(self._start(stage, environment=threads))
        for process in processes:
            process.wait()
        for process in sorted(processes, key=lambda own: -own.wait()):
            self._ended("refused" if process.wait() == 2 else "done", process, before)

    def _undo(self, stage: str) -> None:
        """Delete what a stage wrote."""
        for name in self.reference.sizes[stage]:
            (self.folder / name).unlink(missing_ok=True)

    def _start(self, stage: str, *more: str, environment: dict[str, str] | None = None) -> Stage:
        # Where every process of a stage is killed, what joblib has on a disk stays behind.
        process = Stage(
            stage, self.folder, *self.more, *more, environment=environment or None,
            limit=self.disk.limit, scratch=self.folder.parent,
        )  # fmt: skip
        self._groups.append(process.pid)
        return process

    def _ended(self, what: str, process: Stage, before: dict) -> None:
        done, after = process.done(), _digests(self.folder)
        changed = frozenset(path for path, digest in before.items() if after.get(path) != digest)
        added = frozenset(after.keys() - before.keys())
        self.events.append(Event(what, process.stage, done.returncode, done.stderr, changed, added))


def tables(folder: Path) -> dict[str, list[list[str]]]:
    """Every CSV of the results, cell by cell, without what tells how long something took."""
    found = {}
    for path in sorted((folder / "results").rglob("*.csv")):
        with open(path, encoding="utf-8", newline="") as file:
            header, *rows = csv.reader(file)
        columns = [k for k, name in enumerate(header) if "ms_per_face" not in name]
        found[str(path.relative_to(folder))] = [
            [row[k] for k in columns]
            for row in (header, *rows)
            if not any("ms_per_face" in cell for cell in row[:2])
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


def _digests(folder: Path) -> dict[Path, str]:
    return {
        path.relative_to(folder): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files_in(folder)
    }
