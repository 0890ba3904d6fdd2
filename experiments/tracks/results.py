"""Histories of training and scores, as every track reads and writes them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from deepmds_keras.io.archives import read_arrays
from deepmds_keras.weights import checkpoint_files
from experiments.figures.style import save
from experiments.figures.summary import summary
from experiments.manifest import clear_results
from experiments.methods import DEEP_MDS, notes
from experiments.run import Run
from experiments.scoring.scores import Scores, per_face
from experiments.scoring.tables import write_csv, write_tables


def write_results(
    run: Run,
    folder: Path,
    metrics: pd.DataFrame,
    scores: dict[str, Scores],
    remarks: Mapping[str, str] = {},
    beside: Mapping[str, str] = {},
    seeds: pd.DataFrame | None = None,
) -> None:
    """Write `metrics.csv`, the tables and `figures/summary`, in the place of an earlier run's.

    Args:
        run: The run.
        folder: Of the results.
        metrics, scores: As from `scores.evaluate`.
        remarks: Notes on methods beside those of their rows.
        beside, seeds: As for `tables.summarise`.
    """
    found = {method: own.found for method, own in scores.items()}
    clear_results(folder)
    write_csv(folder / "metrics.csv", metrics)
    table = write_tables(
        folder,
        metrics,
        experiment=run.track,
        subset_size=run.preset.subset_size,
        notes=notes(run, found) | dict(remarks),
        per_face=per_face(scores),
        beside=beside,
        seeds=seeds,
    )
    save(summary(table, run.track), folder / "figures", "summary")


def load_histories(run: Run) -> dict[str, dict[str, dict]]:
    """Losses of `DEEP_MDS` by method, network and epoch, from the files of the networks."""
    return {
        method: {
            network: read_arrays(path)[1]["history"]
            for network, path in checkpoint_files(run.networks, *settings).items()
        }
        for method, settings in DEEP_MDS.items()
    }
