"""Stage 2: train every network of the experiment; what is complete is loaded, not trained again."""

from __future__ import annotations

import os

import numpy as np
from joblib import Parallel, delayed, effective_n_jobs, parallel_config

from experiments.arguments import parse_run
from experiments.inputs import load_faces
from experiments.methods import DEEP_MDS
from experiments.run import Run
from experiments.running import peak_memory_mb, quiet_tensorflow, stage

# What is trained one after the other in one process: a step keeps about one core busy. `ours` and
# `ours_released` share the autoencoder, which is the same in both variants.
_CHAINS = {
    "bfm": (("ours", "ours_released"), ("ours_stable", "zhao", "zhao_authors")),
    "flame": (("ours", "ours_released"), ("ours_stable", "zhao")),
}


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    # A chain ends with this process, and so has to be on this machine.
    with stage(run, "networks") as record, parallel_config("loky"):
        chains = _CHAINS[run.track]
        jobs = min(len(chains), effective_n_jobs(run.jobs))
        done = Parallel(jobs)(delayed(train_chain)(run, chain, os.getpid()) for chain in chains)
        if jobs > 1:
            record["processes_mb"] = [memory for _, memory in done]
        record["final_rms_error"] = {k: v for errors, _ in done for k, v in errors.items()}


def train_chain(run: Run, methods: tuple[str, ...], parent: int) -> tuple[dict, int]:
    """Train methods in turn, in the process `parent` or in one of its own that ends with it.

    Returns:
        Root of the last losses by method, network and mode, and the process's peak memory in MB.
    """
    # Only the processes that train load TensorFlow.
    from experiments.progress import EpochBar
    from experiments.tracks.recipes import train_deep_mds, train_zhao

    quiet_tensorflow()
    EpochBar.parent = parent
    train = load_faces(run, "train")
    errors = {}
    for method in methods:
        if method not in DEEP_MDS:
            train_zhao(run, train, method)
            continue
        for network, losses in train_deep_mds(run, train, method).history_.items():
            errors[f"{method}/{network}"] = {
                mode: round(float(np.sqrt(loss[-1])), 6) for mode, loss in losses.items()
            }
    return errors, peak_memory_mb()
