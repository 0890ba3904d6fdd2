"""Training steps, timed apart: networks that are trained slow down what comes after them."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor

from experiments.bench.measurements import measure
from experiments.progress import Bar
from experiments.run import Run
from experiments.running import quiet_tensorflow


def in_own_process(run: Run) -> list[dict]:
    """Rows of the training steps, with the threads of training, from a process that then ends."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as other:
        return other.submit(training_steps, run).result()


def training_steps(run: Run) -> list[dict]:
    """`in_own_process` in this one."""
    from experiments.bench import steps
    from experiments.bench.workload import make_workload

    quiet_tensorflow()
    passes, rows = run.preset.bench_passes, []
    with Bar(desc="bench, training", unit="row") as bar:
        for ways in steps.comparisons(make_workload(run)):
            rows += measure("training", ways, passes)
            bar.update(len(ways))
    return rows
