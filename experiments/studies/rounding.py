"""Stage: the paper's recipe from one seed, with sums rounded as other machines round them.

The compiler of training picks instructions that the processor has, and threads split sums: from
the same seed both only change how numbers are rounded. `make` allows those up to AVX2. Compiled
is the dissimilarity net's training alone: of the autoencoder nothing here changes the sums.
"""

from __future__ import annotations

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import pandas as pd
from joblib import effective_n_jobs

from experiments.arguments import parse_run
from experiments.inputs import load_faces
from experiments.manifest import clear_results, records_of, write_manifest
from experiments.methods import METHODS, title
from experiments.progress import EpochBar
from experiments.recipes import deep_mds, fit_deep_mds
from experiments.records import write_text
from experiments.run import Run
from experiments.running import quiet_tensorflow, stage
from experiments.scoring.latex import plain_tabular
from experiments.scoring.scores import score
from experiments.scoring.tables import write_csv

METHOD = "ours"
# Environment of the training, by name.
ROUNDINGS = {
    "as trained": {},
    "again": {},
    "one thread": {"TF_NUM_INTRAOP_THREADS": "1"},
    "all instructions": {"XLA_FLAGS": ""},
    "AVX at most": {"XLA_FLAGS": "--xla_cpu_max_isa=AVX"},
    "SSE 4.2 at most": {"XLA_FLAGS": "--xla_cpu_max_isa=SSE4_2"},
}


def roundings(run: Run) -> pd.DataFrame:
    """Train and score in each way.

    Returns:
        Rows of `method, rounding, mse`.
    """
    with ThreadPoolExecutor(effective_n_jobs(run.jobs)) as threads:
        errors = [*threads.map(_in_own_process, [run] * len(ROUNDINGS), ROUNDINGS)]
    rows = [(METHOD, name, error) for name, error in zip(ROUNDINGS, errors, strict=True)]
    return pd.DataFrame(rows, columns=["method", "rounding", "mse"])


def _in_own_process(run: Run, name: str) -> float:
    # TensorFlow reads the environment once.
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
        return process.submit(_trained, run, name, os.getpid()).result()


def _trained(run: Run, name: str, parent: int) -> float:
    """Error on the test faces."""
    os.environ |= ROUNDINGS[name]
    quiet_tensorflow()
    EpochBar.parent = parent
    model = deep_mds(run, *METHODS[METHOD].deep_mds).set_params(n_jobs=1)
    train, test = load_faces(run, "train"), load_faces(run, "test")
    checkpoint = run.work / "roundings" / name.replace(" ", "-")
    fit_deep_mds(model, train.views, train.shapes, checkpoint=checkpoint)
    return float(score(model.predict(test.views, check_orientation=False), test).mse.mean())


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    folder = run.experiment_results("rounding")
    with stage(run, "rounding"):
        table = roundings(run)
        clear_results(folder)
        write_csv(folder / "table.csv", table)
        named = table.assign(method=table["method"].map(title))
        write_text(folder / "table.tex", plain_tabular(named))
    write_manifest(run, "seeds", records_of(run, "rounding"), folder)
    print(f"\n{run.model}, one seed\n\n{named.to_string(index=False)}\n")
