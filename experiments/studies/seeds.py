"""Deep-MDS from several seeds: the spread, and its cause.

Faces, views, initial weights and mini-batches all come from the seed.
"""

from __future__ import annotations

from dataclasses import replace

import pandas as pd

from deepmds_keras.io.archives import read_arrays
from deepmds_keras.weights import checkpoint_files
from experiments.arguments import parse_run
from experiments.build_key import is_done
from experiments.figures.curves import batchnorm_lag
from experiments.figures.style import save
from experiments.figures.summary import seed_spread
from experiments.manifest import clear_results, records_of, write_manifest
from experiments.methods import DEEP_MDS, title
from experiments.records import write_text
from experiments.run import Run
from experiments.running import stage
from experiments.scoring.latex import plain_tabular
from experiments.scoring.scores import metrics_by_seed, runs_by_seed
from experiments.scoring.tables import write_csv
from experiments.studies.seed import run_seed
from experiments.tracks.bfm.faces import make_faces


def train(run: Run) -> None:
    """Train and score one seed, unless that is done."""
    if not is_done(run, "faces"):
        with stage(run, "faces") as record:
            record |= make_faces(run)
    if not is_done(run, "seed"):
        with stage(run, "seed") as record:
            record["rows"] = run_seed(run)


def spread(metrics: pd.DataFrame) -> pd.DataFrame:
    """Median, mean, s.d. (of a sample) and range over the seeds of each method and metric."""
    groups = metrics.groupby(["method", "metric"], sort=False)["value"]
    return groups.agg(["median", "mean", "std", "min", "max", "count"]).reset_index()


def autoencoder_histories(run: Run, metrics: pd.DataFrame) -> dict[str, dict[int, dict]]:
    """Losses of the autoencoder by schedule and seed, as `batchnorm_lag` draws them."""
    errors = metrics.set_index(["method", "metric", "seed"])["value"]
    found: dict[str, dict[int, dict]] = {}
    for method, (variant, schedule) in DEEP_MDS.items():
        if schedule in found:  # methods of a schedule share the autoencoder
            continue
        found[schedule] = {}
        for seed in metrics["seed"].unique():
            files = checkpoint_files(replace(run, seed=int(seed)).networks, variant, schedule)
            losses = read_arrays(files["autoencoder"])[1]["history"]
            anew = errors[method, "autoencoder_mse_reestimated", seed]
            found[schedule][int(seed)] = losses | {"reestimated": anew}
    return found


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    for own in runs_by_seed(run):
        train(own)
    folder = run.experiment_results("seeds")
    with stage(run, "seeds") as record:
        record["n_seeds"] = run.n_seeds
    metrics = metrics_by_seed(run)
    clear_results(folder)
    write_csv(folder / "metrics.csv", metrics)
    table = spread(metrics)
    write_csv(folder / "table.csv", table)
    named = table.assign(method=table["method"].map(title))
    write_text(folder / "table.tex", plain_tabular(named))
    save(seed_spread(metrics), folder / "figures", "seed_spread")
    save(batchnorm_lag(autoencoder_histories(run, metrics)), folder / "figures", "batchnorm_lag")
    records = [record for own in runs_by_seed(run)[1:] for record in records_of(own, "seed")]
    write_manifest(run, "seeds", records_of(run, "seeds") + records, folder)
    print(f"\n{run.model}, {run.n_seeds} seeds\n")
    print(named.to_string(index=False))
    print(f"\nTables, figures and manifest: {folder}/")
