"""Trainings side by side: a process per core, all on this machine."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any

from joblib import Parallel, delayed, effective_n_jobs, parallel_config

from experiments.progress import EpochBar
from experiments.running import peak_memory_mb, quiet_tensorflow


def side_by_side(
    jobs: int, function: Callable, trainings: Sequence[tuple]
) -> tuple[list[Any], list[int]]:
    """Call `function(*training)` for every training, in processes that end when this one does.

    Args:
        jobs: Processes, -1 for every core.
        function: Of a module, not nested; with bars that are `EpochBar`s, which end it.
        trainings: Its arguments.

    Returns:
        What the calls returned, in the order of the trainings, and the peak memory of each process
        that was started, MB.
    """
    jobs = min(max(len(trainings), 1), effective_n_jobs(jobs))
    with parallel_config("loky"):  # a cluster's process would not end with this one
        done = Parallel(jobs)(delayed(_train)(os.getpid(), function, own) for own in trainings)
    # A process does one training after the other, and only ever grows.
    memory = sorted(memory for _, memory in done)[-jobs:] if jobs > 1 else []
    return [result for result, _ in done], memory


def _train(parent: int, function: Callable, training: tuple) -> tuple[Any, int]:
    quiet_tensorflow()
    EpochBar.parent = parent
    return function(*training), peak_memory_mb()
