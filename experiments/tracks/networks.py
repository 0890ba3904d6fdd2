"""Stage 2: train every network of the experiment; one that was stopped goes on where it was."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence

import numpy as np
from joblib import Parallel, delayed, effective_n_jobs, parallel_config

from experiments.arguments import parse_run
from experiments.methods import METHODS, methods_of
from experiments.progress import EpochBar
from experiments.run import Run
from experiments.running import peak_memory_mb, quiet_tensorflow, stage


def chains(run: Run) -> list[list[str]]:
    """Methods to train, those of one process together: a step keeps about one core busy."""
    found: dict[int, list[str]] = {}
    for method in methods_of(run, "predictions"):
        if method.train is not None:
            found.setdefault(method.process, []).append(method.id)
    return [found[process] for process in sorted(found)]


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    # A chain ends with this process, and so has to be on this machine.
    with stage(run, "networks") as record, parallel_config("loky"):
        todo = chains(run)
        jobs = min(len(todo), effective_n_jobs(run.jobs))
        done = Parallel(jobs)(delayed(train_chain)(run, chain, os.getpid()) for chain in todo)
        if jobs > 1:
            record["processes_mb"] = [memory for *_, memory in done]
        record["final_rms_error"] = {k: v for errors, *_ in done for k, v in errors.items()}
        record["training_seconds"] = {k: v for _, taken, _ in done for k, v in taken.items()}


def train_chain(run: Run, methods: Sequence[str], parent: int) -> tuple[dict, dict, int]:
    """Train methods in turn, in the process `parent` or in one of its own that ends with it.

    Returns:
        Root of the last losses of the paper's method by network and mode, seconds of each method
        (of what earlier ones, or a run that was stopped, had not trained), and the process's peak
        memory in MB.
    """
    quiet_tensorflow()
    EpochBar.parent = parent
    errors, seconds = {}, {}
    for method in methods:
        clock = time.perf_counter()
        history = METHODS[method].train(run).history_
        seconds[method] = round(time.perf_counter() - clock, 1)
        for network, losses in history.items() if METHODS[method].deep_mds else ():
            errors[f"{method}/{network}"] = {
                mode: round(float(np.sqrt(loss[-1])), 6) for mode, loss in losses.items()
            }
    return errors, seconds, peak_memory_mb()
