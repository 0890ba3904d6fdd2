"""Tasks of a step, shared by the cores of this machine."""

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

from joblib import Parallel, delayed
from threadpoolctl import threadpool_limits


def unordered(jobs: int, function: Callable, tasks: Iterable[tuple]) -> Iterator:
    """Yield `function(*task)` of every task, in the order in which they are done.

    Args:
        jobs: Processes, -1 for every core.
        function: Module-level function, since processes import it. Each has one thread.
        tasks: Small arguments, such as paths and numbers.
    """
    yield from Parallel(jobs, return_as="generator_unordered")(
        delayed(call_single_threaded)(function, *task) for task in tasks
    )


@contextmanager
def single_threaded() -> Iterator[None]:
    """Compute and draw with one thread: one process per core, and sums in the same order always."""
    os.environ.setdefault("LP_NUM_THREADS", "1")  # of Mesa's software renderer
    with threadpool_limits(1):
        yield


def call_single_threaded(function: Callable, *arguments):
    """Call a function in `single_threaded`, as a task of another process."""
    with single_threaded():
        return function(*arguments)
