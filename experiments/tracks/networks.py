"""Stage 2: train every network of the experiment; one that was stopped goes on where it was."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from experiments.arguments import parse_run
from experiments.methods import METHODS, methods_of
from experiments.run import Run
from experiments.running import stage
from experiments.trainings import side_by_side


def chains(run: Run) -> list[list[str]]:
    """Methods to train, those of one process together: a step keeps about one core busy."""
    found: dict[int, list[str]] = {}
    for method in methods_of(run, "predictions"):
        if method.train is not None:
            found.setdefault(method.process, []).append(method.id)
    return [found[process] for process in sorted(found)]


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    with stage(run, "networks") as record:
        todo = [(run, chain) for chain in chains(run)]
        done, record["processes_mb"] = side_by_side(run.jobs, train_chain, todo)
        record["final_rms_error"] = {k: v for errors, _ in done for k, v in errors.items()}
        record["training_seconds"] = {k: v for _, taken in done for k, v in taken.items()}


def train_chain(run: Run, methods: Sequence[str]) -> tuple[dict, dict]:
    """Train methods in turn.

    Returns:
        Root of the last losses of the paper's method by network and mode, and seconds of each
        method (of what earlier ones, or a run that was stopped, had not trained).
    """
    errors, seconds = {}, {}
    for method in methods:
        clock = time.perf_counter()
        history = METHODS[method].train(run).history_
        seconds[method] = round(time.perf_counter() - clock, 1)
        for network, losses in history.items() if METHODS[method].deep_mds else ():
            errors[f"{method}/{network}"] = {
                mode: round(float(np.sqrt(loss[-1])), 6) for mode, loss in losses.items()
            }
    return errors, seconds
