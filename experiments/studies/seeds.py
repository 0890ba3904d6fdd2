"""The paper's recipe and the one with a cosine schedule from several seeds: spread, and its cause.

Faces, views, initial weights and mini-batches all come from the seed, so that each of them is a
run of `make reproduce-bfm SEED=…` cut down to two methods, whose files that command goes on from.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from deepmds_keras.io.archives import read_arrays
from deepmds_keras.weights import checkpoint_files
from experiments.arguments import parse_run
from experiments.build_key import is_done
from experiments.figures.curves import batchnorm_lag
from experiments.figures.style import save
from experiments.figures.summary import seed_spread
from experiments.inputs import Faces, load_faces
from experiments.manifest import clear_results, write_manifest
from experiments.methods import DEEP_MDS, METHODS, load, title
from experiments.records import load_record, write_text
from experiments.run import Run
from experiments.running import stage
from experiments.scoring.latex import plain_tabular
from experiments.scoring.scores import load_prediction, score
from experiments.scoring.tables import write_csv
from experiments.tracks.bfm.faces import make_faces
from experiments.tracks.networks import train_chain
from experiments.trainings import side_by_side

_COMPARED = ("ours", "ours_stable")


def run_seed(run: Run) -> list[tuple[str, str, float]]:
    """Train and score both methods of one seed; what its folder already holds is used.

    Returns:
        Rows of `method, metric, value`.
    """
    from experiments.tracks.predictions import predict

    side_by_side(run.jobs, train_chain, [(run, (method,)) for method in _COMPARED])
    train, test = load_faces(run, "train"), load_faces(run, "test")
    rows = []
    for method in _COMPARED:
        predict(run, test, METHODS[method])
        scores = score(load_prediction(run, method)[0]["shapes"], test)
        values = {
            "mse": scores.mse.mean(),
            "mse_mm2": scores.mse_mm2.mean(),
            "depth_corr": scores.depth_corr.mean(),
            "reflection_rate": scores.mirrored.mean(),
            **autoencoder_errors(run, train, method),
        }
        rows += [(method, metric, float(value)) for metric, value in values.items()]
    return rows


def autoencoder_errors(run: Run, train: Faces, method: str) -> dict[str, float]:
    """Mean squared errors of the autoencoder on the training faces, by statistics."""
    from deepmds_keras.networks import forward
    from experiments.studies.batchnorm import recalibrate_batchnorm

    model = load(run, method)
    network, history = model.autoencoder_, model.history_["autoencoder"]
    flat = train.views.reshape(len(train.views), -1)
    anew = forward(recalibrate_batchnorm(network, flat), flat).reshape(train.views.shape)
    return {
        "autoencoder_mse_train": history["train"][-1],
        "autoencoder_mse_inference": history["inference"][-1],
        "autoencoder_mse_reestimated": np.mean((anew - train.shapes[..., :2]) ** 2),
    }


def spread(metrics: pd.DataFrame) -> pd.DataFrame:
    """Median, mean, s.d. (of a sample) and range over the seeds of each method and metric."""
    groups = metrics.groupby(["method", "metric"], sort=False)["value"]
    return groups.agg(["median", "mean", "std", "min", "max", "count"]).reset_index()


def autoencoder_histories(run: Run, metrics: pd.DataFrame) -> dict[str, dict[int, dict]]:
    """Losses of the autoencoder by schedule and seed, as `batchnorm_lag` draws them."""
    errors = metrics.set_index(["method", "metric", "seed"])["value"]
    found = {}
    for method in _COMPARED:
        variant, schedule = DEEP_MDS[method]
        found[schedule] = {}
        for seed in metrics["seed"].unique():
            files = checkpoint_files(replace(run, seed=int(seed)).networks, variant, schedule)
            losses = read_arrays(files["autoencoder"])[1]["history"]
            anew = errors[method, "autoencoder_mse_reestimated", seed]
            found[schedule][int(seed)] = losses | {"reestimated": anew}
    return found


def main(arguments: list[str] | None = None) -> None:
    first = parse_run(__doc__, arguments)
    runs = [replace(first, seed=first.seed + k) for k in range(first.preset.n_seeds)]
    frames, records = [], []
    for run in runs:
        if not is_done(run, "faces"):
            with stage(run, "faces") as record:
                record |= make_faces(run)
        if not is_done(run, "seeds"):
            with stage(run, "seeds") as record:
                record["rows"] = run_seed(run)
        for name in ("faces", "seeds"):
            records.append(load_record(run, name))
        rows = pd.DataFrame(records[-1].pop("rows"), columns=["method", "metric", "value"])
        frames.append(rows.assign(seed=run.seed))
    metrics = pd.concat(frames, ignore_index=True)[["method", "seed", "metric", "value"]]
    folder = first.experiment_results("seeds")
    clear_results(folder)
    write_csv(folder / "metrics.csv", metrics)
    table = spread(metrics)
    write_csv(folder / "table.csv", table)
    named = table.assign(method=table["method"].map(title))
    write_text(folder / "table.tex", plain_tabular(named))
    save(seed_spread(metrics), folder / "figures", "seed_spread")
    save(batchnorm_lag(autoencoder_histories(first, metrics)), folder / "figures", "batchnorm_lag")
    write_manifest(first, "seeds", records, folder)
    print(f"\n{first.model}, {len(runs)} seeds\n")
    print(named.to_string(index=False))
    print(f"\nTables, figures and manifest: {folder}/")
