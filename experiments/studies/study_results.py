"""How studies write and print their results."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.stats import sem

from data_gen.models.registry import TITLES
from experiments.figures.style import save
from experiments.methods import title
from experiments.records import new_results, write_csv, write_text
from experiments.run import Run
from experiments.scoring.latex import tabular
from experiments.scoring.metrics import METRICS
from experiments.scoring.numbers import plus_minus, power, scientific

_NOTHING = 1e-12  # an error that is rounding
_UNIT = 1e-4  # in which these are shown
_IN_UNIT = {
    "mse": METRICS["mse"].head,
    "autoencoder_mse_train": "autoencoder's MSE, training mode",
    "autoencoder_mse_inference": "autoencoder's MSE, inference mode",
    "autoencoder_mse_reestimated": "autoencoder's MSE, recomputed statistics",
}
_HEADS = {
    **{metric.id: metric.head for metric in METRICS.values()},
    "mirrored": METRICS["reflection_rate"].head,  # of one face
    **{metric: f"{head} ({power(_UNIT)})" for metric, head in _IN_UNIT.items()},
}


def write_results(
    run: Run,
    name: str | Path,
    tables: Mapping[str, pd.DataFrame],
    cells: pd.DataFrame,
    notes: Sequence[str] = (),
    figures: Mapping[str, Figure] = {},
) -> dict:
    """Write CSV, `table.tex` and figures, print the table, and return entries for the record.

    Args:
        name: Name of the folder in the model's results, or a folder for several models.
        cells: The table for readers, as from `grid` or `statistics_cells`.
        notes: Lines below it.
    """
    folder = name if isinstance(name, Path) else run.experiment_results(name)
    new = new_results(folder)
    for table, rows in tables.items():
        write_csv(new / f"{table}.csv", rows)
    columns = "l" * cells.index.nlevels + "r" * cells.shape[1]
    cells = cells.reset_index()
    write_text(new / "table.tex", tabular(cells, columns, notes))
    for figure, drawn in figures.items():
        save(drawn, new / "figures", figure, run.preset.caution)
    shown = cells.to_string(index=False)
    print(f"\n{TITLES[run.model]}\n", shown, "", *notes, f"{folder}/", sep="\n")
    return {"results": [folder]}


def mean_error(errors: np.ndarray) -> dict[str, float]:
    """Mean of the errors of faces, its standard error and their number, as columns of a table."""
    return {"mse": float(errors.mean()), "sem": float(sem(errors)), "n_faces": len(errors)}


def grid(table: pd.DataFrame, rows: str | list[str], columns: str, unit: float) -> pd.DataFrame:
    """Texts `mse ± sem` in a unit by the values of some columns, in their order in the table."""
    texts = [
        "0" if row.mse < _NOTHING else plus_minus(row.mse, row.sem, unit)
        for row in table.itertuples()
    ]
    cells = table.assign(text=texts).pivot_table("text", rows, columns, "first", sort=False)
    return cells.fillna("").rename_axis(columns=None)


def statistics_cells(table: pd.DataFrame) -> pd.DataFrame:
    """Texts with five digits for statistics by `method` and `metric`; counts are whole."""
    rows = table.assign(method=table["method"].map(title)).set_index(["method", "metric"])
    units = [_UNIT if metric in _IN_UNIT else 1 for _, metric in rows.index]
    counts = rows.select_dtypes("integer").map("{:,}".format)
    cells = rows.drop(columns=counts).div(units, axis=0).map(scientific, digits=5)
    cells = cells.join(counts)[[*rows]].rename(_HEADS, level="metric")
    return cells.rename(columns=lambda name: name.replace("_", " "))
