"""Step: the spread of Deep-MDS over seeds, and its cause, from the records of `studies.seed`.

Faces, views, initial weights and mini-batches all come from the seed.
"""

from __future__ import annotations

from dataclasses import replace

import pandas as pd

from deepmds_keras.io.archives import read_arrays
from deepmds_keras.weights import checkpoint_files
from experiments.figures.curves import batchnorm_lag
from experiments.figures.style import save
from experiments.figures.summary import seed_spread
from experiments.methods import DEEP_MDS, title
from experiments.records import clear_results, write_csv, write_text
from experiments.run import Run
from experiments.scoring.latex import plain_tabular
from experiments.scoring.scores import metrics_by_seed


def main(run: Run) -> dict:
    metrics = metrics_by_seed(replace(run, seeds=run.n_seeds))
    table = spread(metrics, ["method", "metric"])
    titled = table.assign(method=table["method"].map(title))
    figures = {
        "seed_spread": seed_spread(metrics),
        "batchnorm_lag": batchnorm_lag(autoencoder_histories(run, metrics)),
    }
    folder = run.experiment_results("seeds")
    clear_results(folder)
    write_csv(folder / "metrics.csv", metrics)
    write_csv(folder / "table.csv", table)
    write_text(folder / "table.tex", plain_tabular(titled))
    for name, figure in figures.items():
        save(figure, folder / "figures", name, run.preset.caution)
    print(f"\n{run.model}, {run.n_seeds} seeds\n\n{titled.to_string(index=False)}\n\n{folder}/")
    return {"n_seeds": run.n_seeds, "results": [folder]}


def spread(metrics: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Median, mean, s.d. (of a sample), range and number of the seeds' `value` in each group."""
    groups = metrics.groupby(by, sort=False)["value"]
    return groups.agg(["median", "mean", "std", "min", "max", "count"]).reset_index()


def autoencoder_histories(run: Run, metrics: pd.DataFrame) -> dict[str, dict[int, dict]]:
    """Losses of the autoencoder by schedule and seed, as `batchnorm_lag` draws them."""
    errors = metrics.set_index(["method", "metric", "seed"])["value"]
    histories: dict[str, dict[int, dict]] = {}
    for method in ("ours", "ours_stable"):  # the third method has the autoencoder of the first
        variant, schedule = DEEP_MDS[method]
        histories[schedule] = {}
        for seed in map(int, metrics["seed"].unique()):
            files = checkpoint_files(replace(run, seed=seed).networks, variant, schedule)
            losses = read_arrays(files["autoencoder"])[1]["history"]
            reestimated = errors[method, "autoencoder_mse_reestimated", seed]
            histories[schedule][seed] = losses | {"reestimated": reestimated}
    return histories
