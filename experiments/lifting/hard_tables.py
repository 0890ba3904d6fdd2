"""Tables of the protocol `hard`: errors by condition and yaw, their ratio to the limit's, coverage.

Errors come by cell, which is a method's id, a condition and a seed.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from scipy.stats import sem

from data_gen.views.projections import HARD_YAW
from experiments.lifting.calibration import NOMINAL, WITHIN
from experiments.lifting.hard_networks import Cell
from experiments.lifting.views import CONDITIONS, MOST_MISSING
from experiments.methods import title
from experiments.scoring.latex import tabular
from experiments.scoring.numbers import NOTHING, plus_minus

LIMIT = "limit"
# Metrics of the tables that are read.
HEADS = {"mse": "MSE (10⁻⁶)", "times_limit": "Ratio to the limit"} | {
    name: f"Share of true coordinates {name.replace('_', ' ').replace('sd', 's.d.')}"
    for name in WITHIN.values()
}
_UNIT = 1e-6
_TITLES = {condition.id: condition.title for condition in CONDITIONS}
_YAW_STEP = 10.0  # degrees
_FILLED = "missing coordinates are put where a regression on those that are seen expects them"
_TOLD = "told the noise together with what its camera cannot express of the perspective"
NOTES = {
    "linear": f"trained for each column; {_FILLED}",
    "aldrian": f"{_TOLD}; {_FILLED}",
    "model_fit": _TOLD,
    "ours_stable": "trained for each column; it has no way to leave a landmark out",
    "lifting": "trained for each column, for all with missing landmarks once, on views that miss "
    f"up to {MOST_MISSING:.0%}",
    "lifting_large": "one network for all columns, trained on hard views of all noises and shares "
    "of missing landmarks",
    LIMIT: "what a single view leaves open to a method that knows the face model and the camera",
}


def by_cell(errors: Mapping[Cell, np.ndarray], covered: Mapping[Cell, np.ndarray]) -> pd.DataFrame:
    """Long table `method, condition, seed, metric, mean, standard_error, n_faces`.

    Args:
        errors: `(n,)` mean squared error of each face.
        covered: `(n, levels)` as from `coverage`, of methods that predict a standard deviation.
    """
    rows = []
    for cell, own in errors.items():
        method, condition, seed = cell
        best = _limit(errors, cell)[: len(own)]
        ratio = own.mean() / best.mean()
        values = {"mse": own, "times_limit": ratio + (own - ratio * best) / best.mean()}
        if cell in covered:
            within = dict(zip(NOMINAL, covered[cell].T, strict=True))
            values |= {name: within[level] for level, name in WITHIN.items()}
        rows += [(method, condition.id, seed, name, *_mean(own)) for name, own in values.items()]
    heads = ["method", "condition", "seed", "metric", "mean", "standard_error", "n_faces"]
    return pd.DataFrame(rows, columns=heads)


def summarise(metrics: pd.DataFrame) -> pd.DataFrame:
    """Mean over seeds of every method in every condition; what is empty has a note.

    Args:
        metrics: As from `by_cell`.

    Returns:
        `method, condition, metric, mean, standard_error` (of the faces), `std` (of the seeds, where
        there are several), `n_seeds, n_faces, note`.
    """
    grouped = metrics.groupby(["method", "condition", "metric"], sort=False)
    table = grouped.agg(
        mean=("mean", "mean"),
        standard_error=("standard_error", "mean"),
        std=("mean", "std"),
        n_seeds=("seed", "count"),
        n_faces=("n_faces", "first"),
    ).reset_index()
    methods = [*dict.fromkeys(metrics["method"])]
    every = pd.MultiIndex.from_product([methods, [c.id for c in CONDITIONS]])
    measured = pd.MultiIndex.from_frame(table[["method", "condition"]])
    empty = pd.DataFrame([*every.difference(measured)], columns=["method", "condition"])
    table = pd.concat([table, empty.assign(metric="mse")], ignore_index=True)
    table[["n_seeds", "n_faces"]] = table[["n_seeds", "n_faces"]].astype("Int64")
    places = {name: k for k, name in enumerate([*methods, *every.levels[1]])}
    table = table.sort_values(
        ["method", "condition"], key=lambda own: own.map(places), kind="stable", ignore_index=True
    )
    return table.assign(note=table["method"].map(NOTES))


def by_yaw(errors: Mapping[Cell, np.ndarray], yaw: Mapping[str, np.ndarray]) -> pd.DataFrame:
    """Long table `method, condition, yaw` (the middle of a bin), `mean, standard_error, n_faces`.

    Args:
        errors: As for `by_cell`; the first seed of each method is taken.
        yaw: `(n,)` degrees of the test faces, to either side, by the id of a condition.
    """
    rows, taken = [], set()
    for (method, condition, _), own in errors.items():
        if condition.protocol != "hard" or (method, condition) in taken:
            continue
        taken.add((method, condition))
        place = np.abs(yaw[condition.id][: len(own)]) // _YAW_STEP
        for step in range(round(HARD_YAW / _YAW_STEP)):
            if (place == step).sum() > 1:
                middle = (step + 0.5) * _YAW_STEP
                rows.append((method, condition.id, middle, *_mean(own[place == step])))
    heads = ["method", "condition", "yaw", "mean", "standard_error", "n_faces"]
    return pd.DataFrame(rows, columns=heads)


def calibration(covered: Mapping[Cell, np.ndarray]) -> pd.DataFrame:
    """Long table `method, condition, seed, nominal, observed, standard_error, n_faces`.

    Args:
        covered: As for `by_cell`.
    """
    rows = [
        (method, condition.id, seed, level, *_mean(own))
        for (method, condition, seed), levels in covered.items()
        for level, own in zip(NOMINAL, levels.T, strict=True)
    ]
    heads = ["method", "condition", "seed", "nominal", "observed", "standard_error", "n_faces"]
    return pd.DataFrame(rows, columns=heads)


def latex(table: pd.DataFrame) -> str:
    r"""Errors and standard errors, methods by conditions, as a booktabs `tabular` to `\input`."""
    return tabular(cells(table, "mse"), "l" + "r" * len(CONDITIONS), remarks(table))


def text(table: pd.DataFrame) -> str:
    """The same for the terminal, then the ratios to the limit and what the s.d.s cover."""
    blocks = [f"{head}\n{cells(table, m).to_string(index=False)}" for m, head in HEADS.items()]
    return "\n\n".join([*blocks, "\n".join(remarks(table))])


def cells(table: pd.DataFrame, metric: str) -> pd.DataFrame:
    """Means and standard errors of a metric of `HEADS`, methods by conditions.

    Args:
        table: As from `summarise`, or as read.
        metric: Its id.
    """
    own = table[table["metric"] == metric].set_index(["method", "condition"])
    unit = _UNIT if metric == "mse" else 1.0
    rows = []
    for method in own.index.unique("method"):
        row = {"Method": title(method)}
        for condition in CONDITIONS:
            known = (method, condition.id) in own.index
            cell = own.loc[(method, condition.id), ["mean", "standard_error"]] if known else ()
            row[condition.title] = plus_minus(*cell, unit=unit) if known else NOTHING
        rows.append(row)
    return pd.DataFrame(rows)


def remarks(table: pd.DataFrame) -> list[str]:
    """Remarks: what the numbers are, over how many faces, the spread over seeds, the notes.

    Args:
        table: As for `cells`.
    """
    counts = table[(table["metric"] == "mse") & table["n_faces"].notna()]
    most = counts["n_faces"].max()
    said = [
        "MSE: mean square over coordinates in 10⁻⁶ of the squared min-max unit, after Procrustes "
        f"alignment with scale and reflection, ± its standard error over {most:,.0f} test faces."
    ]
    for n, own in counts[counts["n_faces"] < most].groupby("n_faces"):
        said.append(f"{', '.join(map(title, own['method'].unique()))}: the first {n:,.0f} of them.")
    for _, own in counts[counts["n_seeds"] > 1].iterrows():
        said.append(
            f"{title(own['method'])}, {_TITLES[own['condition']]}: mean over {own['n_seeds']:.0f} "
            f"seeds, whose s.d. is {own['std'] / own['mean']:.1%} of it."
        )
    known = [method for method in table["method"].unique() if method in NOTES]
    return said + [f"{title(method)}: {NOTES[method]}." for method in known]


def _mean(values: np.ndarray) -> tuple[float, float, int]:
    """Mean, its standard error, and of how many."""
    return values.mean(), sem(values), len(values)


def _limit(errors: Mapping[Cell, np.ndarray], cell: Cell) -> np.ndarray:
    """Errors of the limit in the condition of a cell."""
    return next(own for (method, c, _), own in errors.items() if (method, c) == (LIMIT, cell[1]))
