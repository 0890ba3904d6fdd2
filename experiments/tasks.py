"""Tasks of a stage, shared by the cores of this machine or by an existing cluster.

`JOBLIB_BACKEND=dask DASK_ADDRESS=tcp://host:8786` or `JOBLIB_BACKEND=ray RAY_ADDRESS=host:6379`, of
a Ray cluster that the machine of the command belongs to, names joblib's own backend for either.
Every process of the cluster needs the packages in the same versions, the repository on its
`PYTHONPATH` and all folders under the same paths; Dask's workers one thread each. They are to be
started anew when code or data sets have changed, or to render after they have loaded TensorFlow.

Tasks take paths, indices and small objects, and write a file: of a large argument one worker could
have the only copy. So a task whose worker is lost is done again by another, which may have joined
after the start, and writes the same.
"""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

from joblib import Parallel, delayed, parallel_config

from deepmds_keras.io.errors import InputError
from experiments.running import single_threaded

# What may change a task's results, in their last digits.
_DECISIVE = (
    "TF_ENABLE_ONEDNN_OPTS", "TF_NUM_INTRAOP_THREADS", "TF_CPP_MIN_LOG_LEVEL", "XLA_FLAGS",
)  # fmt: skip
_SECONDS = 10  # to wait for a cluster
_RETRIES = 3  # of a task whose worker was lost, before the task is taken for the cause


def unordered(jobs: int, function: Callable, tasks: Iterable[tuple]) -> Iterator:
    """Yield `function(*task)` of every task, in the order in which they are done.

    Args:
        jobs: Processes of this machine, -1 for every core; a cluster takes as many as it has.
        function: Of a module, not nested: workers import it.
        tasks: Small arguments, see above.

    Raises:
        InputError: An unknown backend, no address or one where no cluster with a worker is, a
            package that is missing, or a cluster that was lost.
    """
    place = os.getcwd(), {name: os.environ.get(name) for name in _DECISIVE}
    with _backend() as return_as:
        yield from Parallel(jobs, return_as=return_as)(
            delayed(_do)(*place, function, task) for task in tasks
        )


@contextmanager
def _backend() -> Iterator[str]:
    """Set joblib's backend to the one that the environment names; yield how it can return."""
    name = os.environ.get("JOBLIB_BACKEND") or "loky"
    if name == "loky":
        yield "generator_unordered"
        return
    if name not in _CLUSTERS:
        kinds = ", ".join(("loky", *_CLUSTERS))
        raise InputError(f"JOBLIB_BACKEND must be one of {kinds}. Received {name!r}.")
    variable, example, connect = _CLUSTERS[name]
    address = os.environ.get(variable)
    if not address:
        raise InputError(
            f"{variable} must be the address of the cluster, such as {example}, with "
            f"JOBLIB_BACKEND={name}. Received none."
        )
    try:
        _call(address)
        with connect(address) as (n, return_as):
            print(f"  {n} worker{'s' * (n > 1)} of {name} at {address}", flush=True)
            yield return_as
    except ImportError as error:
        raise InputError(
            f"JOBLIB_BACKEND={name} must have its package installed: pip install '.[cluster]'. "
            f"Received {error}."
        ) from None
    except _UnreachableError as error:
        raise InputError(
            f"{variable} must be the address of a cluster in reach, such as {example}, whose "
            f"processes have the repository on their PYTHONPATH. Received {address}: {error}."
        ) from None
    except _LostError as error:
        raise InputError(
            f"{variable}={address} must stay in reach, with workers that live. Received {error}; "
            "run again, what is complete is kept."
        ) from error


class _UnreachableError(Exception):
    """Nobody is there, or nobody who can work."""


class _LostError(Exception):
    """The cluster went away, or a task lost every worker that it was given."""


@contextmanager
def _dask(address: str) -> Iterator[tuple[int, str]]:
    import distributed

    try:
        client = distributed.Client(address, timeout=_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise _UnreachableError(_brief(error)) from None
    with client:
        # Not left to joblib, which waits for ever where the scheduler cannot import a task.
        try:
            client.wait_for_workers(1, timeout=_SECONDS)
            client.submit(_do, os.getcwd(), {}, _nothing, (), pure=False).result(_SECONDS)
        except Exception as error:  # of the worker or of the way to it: any
            raise _UnreachableError(_brief(error) or type(error).__name__) from None
        try:
            with parallel_config("dask", client=client):
                yield sum(client.ncores().values()), "generator_unordered"
        except (distributed.CancelledError, distributed.KilledWorker) as error:
            raise _LostError(type(error).__name__) from error


@contextmanager
def _ray(address: str) -> Iterator[tuple[int, str]]:
    import ray
    from ray.util.joblib import register_ray

    try:
        ray.init(address, log_to_driver=False, logging_level="ERROR")
    except (OSError, ValueError, RuntimeError) as error:
        raise _UnreachableError(_brief(error)) from None
    try:
        n = int(ray.cluster_resources().get("CPU", 0))
        if n == 0:
            raise _UnreachableError("no CPU")
        register_ray()
        again = {"max_restarts": -1, "max_task_retries": _RETRIES}
        with parallel_config("ray", ray_remote_args=again):
            yield n, "list"  # its backend has no generators
    except ray.exceptions.RayError as error:
        raise _LostError(type(error).__name__) from error
    finally:
        ray.shutdown()


# Of each backend: the variable of its address, an example of one, and how to reach it.
_CLUSTERS = {
    "dask": ("DASK_ADDRESS", "tcp://host:8786", _dask),
    "ray": ("RAY_ADDRESS", "host:6379", _ray),
}


def _do(folder: str, environment: dict[str, str | None], function: Callable, task: tuple):
    """Do a task as the process of the command would: there, by its settings, with one thread."""
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
    before = Path.cwd()
    os.chdir(folder)
    try:
        with single_threaded(), parallel_config("sequential"):
            return function(*task)
    finally:
        os.chdir(before)


def _nothing() -> None:
    """Show that a worker can import this module."""


def _call(address: str) -> None:
    """See whether anybody is there: both libraries would try for long, and then say much."""
    try:
        parts = urlsplit(f"//{address.rpartition('/')[2]}")
        if parts.hostname is None or parts.port is None:
            raise ValueError("no host and port")
        socket.create_connection((parts.hostname, parts.port), _SECONDS).close()
    except (OSError, ValueError) as error:
        raise _UnreachableError(_brief(error)) from None


def _brief(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
