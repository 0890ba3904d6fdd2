"""Stages on an existing cluster: its workers do the tasks that `joblib` otherwise gives to cores.

`JOBLIB_BACKEND=dask DASK_ADDRESS=tcp://host:8786` or `JOBLIB_BACKEND=ray RAY_ADDRESS=host:6379`, of
a Ray cluster that the machine of the command belongs to. Workers need the installed packages in the
same versions and the repository and all folders under the same paths. They are to be started anew
when the code has changed, or to render after they have loaded TensorFlow; and Dask's with one
thread each, since a worker does one task at a time.

Whatever a task needs comes with it: one whose worker is lost is done again by another, which may
have joined after the start. So may a task that has written its file: it writes the same again.

joblib's own backend for Dask takes `n_jobs=1` for the whole cluster, and of a large argument one
worker may have the only copy; Ray's own has no generators.
"""

from __future__ import annotations

import os
import pickle
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

from joblib import parallel_config
from joblib.parallel import FallbackToBackend, ParallelBackendBase, SequentialBackend
from threadpoolctl import threadpool_limits

from deepmds_keras.io.errors import InputError

ROOT = Path(__file__).resolve().parents[1]
# By which a task's results may differ, in its last digits.
_DECISIVE = ("TF_ENABLE_ONEDNN_OPTS", "TF_NUM_INTRAOP_THREADS", "TF_CPP_MIN_LOG_LEVEL")
_SECONDS = 10  # to wait for a cluster
_LOSSES = 3  # of a task's worker, before the task is taken for the cause
_SHARED_BYTES = 1 << 20  # of an argument that is sent once, since other tasks may have it too
_SHARED = 8  # such arguments held; what only one task has goes out again
_ALONE = threading.Lock()  # of a worker: thread pools and the working folder are of the process


@contextmanager
def cluster() -> Iterator[None]:
    """Give the tasks of every `Parallel` inside to the cluster that the environment names, if any.

    `n_jobs=1` stays in this process; any other number stands for all workers.

    Raises:
        InputError: An unknown backend, no address or one where no cluster with a worker is, a
            package that is missing, or a cluster that was lost.
    """
    name = os.environ.get("JOBLIB_BACKEND") or "loky"
    if name == "loky":
        yield
        return
    if name not in _KINDS:
        kinds = ", ".join(("loky", *_KINDS))
        raise InputError(f"JOBLIB_BACKEND must be one of {kinds}. Received {name!r}.")
    kind = _KINDS[name]
    address = os.environ.get(kind.variable)
    if not address:
        raise InputError(
            f"{kind.variable} must be the address of the cluster, such as {kind.example}, with "
            f"JOBLIB_BACKEND={name}. Received none."
        )
    try:
        _call(kind, address)
        connected = kind(address)
    except ImportError as error:
        raise InputError(
            f"JOBLIB_BACKEND={name} must have its package installed: pip install '.[cluster]'. "
            f"Received {error}."
        ) from None
    with connected.closing():
        n = connected.n_workers()
        print(f"  {n} worker{'s' * (n > 1)} of {name} at {address}", flush=True)
        try:
            with parallel_config(_Backend(connected)):
                yield
        except connected.losses as error:
            raise InputError(
                f"{kind.variable}={address} must stay in reach, with workers that live. Received "
                f"{type(error).__name__}; run again, what is complete is kept."
            ) from error


class _Backend(ParallelBackendBase):
    """joblib's way to a cluster: tasks as bytes, which only the worker makes objects of."""

    supports_retrieve_callback = True

    def __init__(self, connected: _Dask | _Ray):
        import cloudpickle  # unlike pickle, it takes functions of the command itself

        super().__init__(nesting_level=0)
        self._cluster, self._pickled = connected, cloudpickle.dumps
        environment = {name: os.environ.get(name) for name in _DECISIVE}
        self._entry = _entry(str(ROOT), os.getcwd(), environment)
        self._shared: dict[int, tuple] = {}

    def effective_n_jobs(self, n_jobs: int | None) -> int:
        # What is for one, joblib does itself.
        return 1 if n_jobs in (None, 1) else max(self._cluster.n_workers(), 2)

    def configure(self, n_jobs=1, parallel=None, **_) -> int:
        if n_jobs in (None, 1):
            raise FallbackToBackend(SequentialBackend(nesting_level=self.nesting_level))
        self.parallel = parallel
        return self.effective_n_jobs(n_jobs)

    def submit(self, func, callback):
        ((function, arguments, named),) = func.items
        task = [self._pickled((function, named)), *map(self._sent, arguments)]
        return self._cluster.start(self._entry, task, callback)

    def retrieve_result_callback(self, out):
        return [self._cluster.result(out)]

    def stop_call(self) -> None:
        self._shared.clear()

    def _sent(self, argument):
        """An argument as bytes, or what stands for them on the cluster."""
        _, sent = self._shared.pop(id(argument), (argument, None))
        if sent is None:
            sent = self._pickled(argument)
            if len(sent) < _SHARED_BYTES:
                return sent
            sent = self._cluster.share(sent)
        self._shared[id(argument)] = argument, sent
        if len(self._shared) > _SHARED:
            del self._shared[next(iter(self._shared))]
        return sent


class _Dask:
    """A Dask cluster."""

    variable, example = "DASK_ADDRESS", "tcp://host:8786"

    def __init__(self, address: str):
        import dask
        import distributed

        dask.config.set({"distributed.admin.large-graph-warning-threshold": "1TB"})
        try:
            self.client = distributed.Client(address, timeout=_SECONDS, set_as_default=False)
        except (OSError, ValueError) as error:
            raise _unreachable(type(self), address, error) from None
        self.losses = (CancelledError, distributed.KilledWorker)
        self._address = address

    def closing(self):
        return self.client

    def n_workers(self) -> int:
        try:
            self.client.wait_for_workers(1, timeout=_SECONDS)
        except TimeoutError:
            raise _unreachable(type(self), self._address, "no worker") from None
        return len(self.client.scheduler_info(n_workers=-1)["workers"])

    def share(self, content: bytes):
        # A task, unlike data that are scattered: it is done again where its worker is lost.
        return self.client.submit(bytes, content, pure=False)

    def start(self, entry: Callable, task: list, callback: Callable):
        future = self.client.submit(entry, *task, pure=False)
        future.add_done_callback(callback)
        return future

    def result(self, future):
        return future.result()


class _Ray:
    """A Ray cluster."""

    variable, example = "RAY_ADDRESS", "host:6379"

    def __init__(self, address: str):
        import ray

        try:
            ray.init(address, log_to_driver=False, logging_level="ERROR")
        except (OSError, ValueError, RuntimeError) as error:
            raise _unreachable(type(self), address, error) from None
        self._ray, self._address = ray, address
        self._tasks: dict[Callable, Callable] = {}
        self.losses = (ray.exceptions.RayError,)

    @contextmanager
    def closing(self) -> Iterator[None]:
        with ThreadPoolExecutor(1) as self._callbacks:
            try:
                yield
            finally:
                self._ray.shutdown()

    def n_workers(self) -> int:
        n = int(self._ray.cluster_resources().get("CPU", 0))
        if n == 0:
            raise _unreachable(type(self), self._address, "no CPU")
        return n

    def share(self, content: bytes):
        return self._ray.put(content)

    def start(self, entry: Callable, task: list, callback: Callable):
        if entry not in self._tasks:
            self._tasks[entry] = self._ray.remote(num_cpus=1, max_retries=_LOSSES)(entry)
        future = self._tasks[entry].remote(*task).future()
        # Not in Ray's own thread, which must not wait for the next task to be started.
        future.add_done_callback(lambda done: self._callbacks.submit(callback, done))
        return future

    def result(self, future):
        try:
            return future.result()
        except self._ray.exceptions.RayTaskError as error:
            raise error.cause from error  # whose message is not Ray's traceback


_KINDS = {"dask": _Dask, "ray": _Ray}


def work(environment: dict[str, str | None], folder: str, root: str, task: tuple[bytes, ...]):
    """Do a task in a worker, as the machine of the command would.

    Args:
        environment, folder, root: Values of `_DECISIVE`, working folder and repository there.
        task: Pickled: the function with its named arguments, and each other argument.
    """
    if str(ROOT) != root:
        raise InputError(f"Workers must be started anew for {root}. Received one of {ROOT}.")
    with _ALONE:
        other = [name for name, value in environment.items() if os.environ.get(name) != value]
        if other and "tensorflow" in sys.modules:
            raise InputError(
                f"Workers must be started anew for another {other[0]}. Received one that has "
                f"loaded TensorFlow with {os.environ.get(other[0])}."
            )
        for name in other:
            os.environ.pop(name, None)
            if environment[name] is not None:
                os.environ[name] = environment[name]
        before = os.getcwd()
        os.chdir(folder)
        try:
            with threadpool_limits(1), parallel_config("sequential"):
                (function, named), *arguments = map(pickle.loads, task)
                return function(*arguments, **named)
        finally:
            os.chdir(before)


def _entry(root: str, folder: str, environment: dict[str, str | None]) -> Callable:
    """What a worker starts with; being no function of a module, it comes with its code."""

    module = __name__

    def do(*task):
        import importlib
        import sys

        if root not in sys.path:
            sys.path.insert(0, root)
        return importlib.import_module(module).work(environment, folder, root, task)

    return do


def _call(kind: type[_Dask | _Ray], address: str) -> None:
    """See whether anybody is there: both libraries would try for long, and then say much."""
    try:
        parts = urlsplit(f"//{address.rpartition('/')[2]}")
        if parts.hostname is None or parts.port is None:
            raise ValueError("no host and port")
        socket.create_connection((parts.hostname, parts.port), _SECONDS).close()
    except (OSError, ValueError) as error:
        raise _unreachable(kind, address, error) from None


def _unreachable(kind: type[_Dask | _Ray], address: str, error) -> InputError:
    return InputError(
        f"{kind.variable} must be the address of a cluster in reach, such as {kind.example}. "
        f"Received {address}: {' '.join(str(error).split())}."
    )
