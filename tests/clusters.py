"""Clusters on this machine, as separate processes: a scheduler of Dask with workers, and Ray."""

from __future__ import annotations

import json
import os
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import psutil
import runs
from places import ROOT

from deepmds_keras.io.errors import InputError

_NAMES = ("JOBLIB_BACKEND", "DASK_ADDRESS", "RAY_ADDRESS")
ALONE = {name: value for name, value in runs.ENVIRONMENT.items() if name not in _NAMES} | {
    "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests'}"
}


@dataclass
class Cluster:
    """A cluster, and what a command needs to find it.

    Attributes:
        environment: Variables of the command.
        folder: Working folder of its processes, which is not the command's.
        processes: Those that were started.
    """

    environment: dict[str, str]
    folder: Path
    processes: list[subprocess.Popen] = field(default_factory=list)

    def start(self, stage: str, folder: Path) -> subprocess.Popen:
        """A stage of the experiment, whose folders are named as relative paths."""
        process = subprocess.Popen(
            [sys.executable, "-m", "experiments", stage, "--preset", "smoke"],
            cwd=folder, env=ALONE | self.environment,
            start_new_session=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        self.processes.append(process)
        return process

    def add_worker(self) -> subprocess.Popen:
        """Another worker of a Dask cluster, with one thread; nobody starts it again."""
        options = ("--nthreads", "1", "--no-nanny", "--local-directory", str(self.folder))
        file = ("--scheduler-file", str(self.folder / "scheduler.json"))
        return self.run("dask", "worker", "--host", "127.0.0.1", "--no-dashboard", *options, *file)

    def run(self, module: str, *arguments: str) -> subprocess.Popen:
        """A process of the cluster."""
        with open(self.folder / "log", "a") as log:
            self.processes.append(
                subprocess.Popen(
                    [Path(sys.executable).with_name(module), *arguments],
                    cwd=self.folder,
                    env=ALONE | self.environment,
                    start_new_session=True,
                    stdout=log,
                    stderr=log,
                )  # fmt: skip
            )
        return self.processes[-1]

    def end(self) -> None:
        """End every process that was started, and all that they started."""
        for process in self.processes:
            _kill_family(process)
            process.wait()
            if process.stdout is not None:
                process.stdout.close()


@contextmanager
def dask_cluster(folder: Path, n_workers: int = 2) -> Iterator[Cluster]:
    """A scheduler and workers, on the loopback interface only."""
    cluster, file = Cluster({}, folder), folder / "scheduler.json"
    try:
        options = ("--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        scheduler = cluster.run("dask", "scheduler", *options, "--scheduler-file", str(file))
        wait_until(lambda: file.exists() and file.read_text().endswith("}"), scheduler)
        for _ in range(n_workers):
            cluster.add_worker()
        address = json.loads(file.read_text())["address"]
        cluster.environment |= {"JOBLIB_BACKEND": "dask", "DASK_ADDRESS": address}
        yield cluster
    finally:
        cluster.end()


@contextmanager
def ray_cluster(folder: Path) -> Iterator[Cluster]:
    """Ray with two workers, which speak on the loopback interface and ask for a token.

    Some of Ray's servers listen on every interface, whatever address the node has.
    """
    # pytest's folders have paths that are too long for its sockets.
    session = tempfile.mkdtemp(prefix="ray-")
    token = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
    cluster = Cluster(token, folder)
    # Not 127.0.0.1, in whose place Ray would put the machine's address.
    address = f"127.0.0.2:{_free_port('127.0.0.2')}"
    host, port = address.split(":")
    try:
        head = cluster.run(
            "ray", "start", "--head", "--block", "--num-cpus", "2",
            "--node-ip-address", host, "--port", port, "--ray-client-server-port",
            str(_free_port(host)), "--include-dashboard", "false", "--disable-usage-stats",
            "--object-store-memory", "200000000", "--temp-dir", session,
        )  # fmt: skip
        wait_until(lambda: "Ray runtime started" in (folder / "log").read_text(), head)
        cluster.environment |= {"JOBLIB_BACKEND": "ray", "RAY_ADDRESS": address}
        yield cluster
    finally:
        cluster.end()
        shutil.rmtree(session)


def wait_until(condition: Callable[[], object], process: subprocess.Popen, seconds: float = 60):
    """The condition's value, as soon as it is true; it is to be so before the process has ended."""
    end = time.monotonic() + seconds
    while not (value := condition()):
        assert process.poll() is None, process.stdout and process.stdout.read()
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.01)
    return value


def _free_port(host: str) -> int:
    with socket.create_server((host, 0)) as server:
        return server.getsockname()[1]


def family(process: subprocess.Popen) -> list[psutil.Process]:
    """All processes of its session, itself among them, whoever is their parent by now."""
    return [own for own in psutil.process_iter() if _session(own.pid) == process.pid]


def _kill_family(process: subprocess.Popen) -> None:
    own = family(process)
    for one in own:
        with suppress(psutil.NoSuchProcess):
            one.kill()
    psutil.wait_procs(own, timeout=10)


def _session(pid: int) -> int | None:
    try:
        return os.getsid(pid)
    except ProcessLookupError:
        return None


def told(k: int) -> tuple[int, int, str, str]:
    """Task that tells which process it was, its argument, where it was and by which setting."""
    time.sleep(0.05)
    return os.getpid(), k, os.getcwd(), os.environ["TF_ENABLE_ONEDNN_OPTS"]


def refused(k: int) -> None:
    """Task that refuses an argument."""
    if k == 3:
        raise InputError("k must be below 3. Received 3.")
