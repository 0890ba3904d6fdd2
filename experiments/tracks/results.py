"""What both tracks write of their scores: metrics, tables and the picture of the table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from deepmds_keras.landmarks import load_scheme
from experiments.figures.style import save
from experiments.figures.summary import summary
from experiments.manifest import clear_results
from experiments.records import write_text
from experiments.run import Run
from experiments.scoring.scores import Scores, per_face
from experiments.scoring.tables import to_csv, write_tables


def write_results(
    run: Run,
    folder: Path,
    metrics: pd.DataFrame,
    scores: dict[str, Scores],
    notes: Mapping[str, str],
    beside: Mapping[str, str] = {},
) -> None:
    """Write `metrics.csv`, the tables and `figures/summary`, in the place of an earlier run's.

    Args:
        run: The run.
        folder: Of the results.
        metrics, scores: As from `scores.evaluate`.
        notes, beside: As for `tables.summarise`.
    """
    clear_results(folder)
    write_text(folder / "metrics.csv", to_csv(metrics))
    table = write_tables(
        folder,
        metrics,
        experiment=run.track,
        subset_size=run.preset.subset_size,
        notes=notes,
        per_face=per_face(scores),
        beside=beside,
    )
    save(summary(table, len(load_scheme(run.scheme))), folder / "figures", "summary")
