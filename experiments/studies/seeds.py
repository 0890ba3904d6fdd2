"""Step: errors of Deep-MDS over seeds, and why they differ, from the records of `studies.seed`.

Faces, views, initial weights and mini-batches all come from the seed.
"""

from dataclasses import replace

import pandas as pd

from deepmds_keras.files import read_arrays
from deepmds_keras.weights import checkpoint_files
from experiments.figures.curves import batchnorm_lag
from experiments.figures.summary import errors_by_seed
from experiments.methods import DEEP_MDS
from experiments.run import Run
from experiments.scoring.scores import metrics_by_seed
from experiments.studies.study_results import statistics_cells, write_results


def main(run: Run) -> dict:
    metrics = metrics_by_seed(run)
    table = seed_statistics(metrics, ["method", "metric"])
    figures = {
        "errors_by_seed": errors_by_seed(metrics),
        "batchnorm_lag": batchnorm_lag(autoencoder_histories(run, metrics)),
    }
    tables, cells = {"metrics": metrics, "table": table}, statistics_cells(table)
    return write_results(run, "seeds", tables, cells, figures=figures)


def seed_statistics(metrics: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Median, mean, s.d. (of a sample), range and number of the seeds' `value` in each group."""
    groups = metrics.groupby(by, sort=False)["value"]
    return groups.agg(["median", "mean", "std", "min", "max", "count"]).reset_index()


def autoencoder_histories(run: Run, metrics: pd.DataFrame) -> dict[str, dict[int, dict]]:
    """Losses of the autoencoder by schedule and seed, as `batchnorm_lag` draws them."""
    errors = metrics.set_index(["method", "metric", "seed"])["value"]
    histories = {"constant": {}, "cosine": {}}
    # The third method has the autoencoder of the first.
    for method in ("deep_mds", "deep_mds_cosine"):
        variant, schedule = DEEP_MDS[method]
        for seed in map(int, metrics["seed"].unique()):
            files = checkpoint_files(replace(run, seed=seed).networks, variant, schedule)
            losses = read_arrays(files["autoencoder"])[1]["history"]
            reestimated = errors[method, "autoencoder_mse_reestimated", seed]
            histories[schedule][seed] = losses | {"reestimated": reestimated}
    return histories
