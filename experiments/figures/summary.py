"""The headline figure, every method next to the paper's number, and the errors of several seeds."""

import textwrap

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiments.figures.errors import plain_log_ticks
from experiments.figures.style import INK, look, styled
from experiments.methods import title
from experiments.scoring.numbers import power

_MSE_UNIT = 1e-4
_NUMBERS = ["mean", "std", "paper_mean", "median", "lowest", "highest"]


@styled
def summary(table: pd.DataFrame, n_landmarks: int, unit: float = _MSE_UNIT) -> Figure:
    """MSE and missing depth correlation of every method: filled here, hollow in the paper.

    The depth correlation is a trace with the number of landmarks as its maximum. The figure shows
    how much is missing, since the values themselves differ in the fourth digit only.

    Args:
        table: `method` (id), `metric` (`"mse"`, `"depth_corr"`), `mean`, `std`, `paper_mean`; NaN
            where there is no number. Perhaps also `n_seeds`, `median`, `lowest` and `highest` over
            seeds.
        unit: Power of ten in which the errors are counted.
    """
    methods = table["method"].unique()
    rows = table.reindex(columns=["metric", "method", *_NUMBERS]).set_index(["metric", "method"])
    mse = rows.loc["mse"].reindex(methods) / unit
    depth_corr = rows.loc["depth_corr"].reindex(methods)
    missing = (n_landmarks - depth_corr).assign(std=depth_corr["std"])
    # For the FLAME landmarks, the paper prints values above the maximum.
    impossible = missing["paper_mean"] < 0
    missing["paper_mean"] = missing["paper_mean"].mask(impossible)
    figure = Figure(figsize=(7.2, 1.0 + 0.2 * len(methods)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    _draw_rows(left, mse)
    left.set_xlabel(f"MSE ({power(unit)} squared normalised units)\n← better")
    _draw_rows(right, missing)
    not_drawn = f"; as published above {n_landmarks}: not drawn" if impossible.any() else ""
    right.set_xlabel(f"{n_landmarks} − depth correlation (no unit)\n← better{not_drawn}")
    left.set_yticks(range(len(methods)), [title(method) for method in methods])
    left.set_ylim(len(methods) - 0.5, -0.5)
    dot = {"color": INK, "marker": "o", "ms": 5}
    handles = [Line2D([], [], **dot, lw=0.9, label="this work, mean ± s.d., if beyond the marker")]
    if "n_seeds" in table:
        label = f"over {table['n_seeds'].max():.0f} seeds, median and range"
        handles.append(Line2D([], [], **dot, lw=3, alpha=0.6, label=label))
    handles.append(Line2D([], [], **dot, mfc="white", lw=0, label="as published"))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


def _draw_rows(axes: Axes, rows: pd.DataFrame) -> None:
    """Draw a row per method: ours filled, with s.d. or range over seeds; the published hollow."""
    for y, row in enumerate(rows.itertuples()):
        drawn = look(row.Index)
        style = {"color": drawn.colour, "marker": drawn.marker, "linestyle": "none"}
        axes.plot(row.paper_mean, y, **style, ms=6.5, mfc="none", mew=0.9)
        if np.isnan(row.median):
            axes.errorbar(row.mean, y, xerr=row.std, **style, ms=4.5, mew=0, elinewidth=1)
        else:
            axes.plot([row.lowest, row.highest], [y, y], color=drawn.colour, lw=3, alpha=0.45)
            axes.plot(row.median, y, **style, ms=4.5, mew=0)
        if np.isnan(row.mean) and np.isnan(row.median):
            place = {"transform": axes.get_yaxis_transform(), "va": "center", "ha": "right"}
            axes.text(0.99, y, "not run", color=INK, size=6, **place)
        if y % 2 == 0:
            axes.axhspan(y - 0.5, y + 0.5, color="#F5F5F5", lw=0, zorder=0)
    axes.set_xscale("log", nonpositive="clip")
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x")
    axes.margins(x=0.1)
    plain_log_ticks(axes.xaxis)


@styled
def errors_by_seed(table: pd.DataFrame) -> Figure:
    """MSE of every training run, one dot per seed, with runs of the same seed joined.

    Args:
        table: One row a run: `method` (id), `seed`, `metric` (only `"mse"` is drawn), `value` in
            squared normalised units.
    """
    runs = table[table["metric"] == "mse"].pivot(index="seed", columns="method", values="value")
    runs = runs[[method for method in table["method"].unique() if method in runs]] / _MSE_UNIT
    figure = Figure(figsize=(1.2 + 1.1 * len(runs.columns), 3.0), layout="constrained")
    axes = figure.subplots()
    axes.plot(range(len(runs.columns)), runs.T, color="#CCCCCC", lw=0.6, zorder=1)
    labels = []
    for x, (method, values) in enumerate(runs.items()):
        drawn = look(method)
        style = {"marker": drawn.marker, "color": drawn.colour, "ls": "none", "ms": 5}
        axes.plot(np.full(len(values), x), values, **style, mec="white", mew=0.5)
        axes.plot([x - 0.16, x + 0.16], [values.median()] * 2, color=INK, zorder=3)
        name = textwrap.fill(title(method), 18)
        labels.append(f"{name}\n{values.count()} seeds\nmedian {values.median():#.3g}")
    axes.set(yscale="log", ylabel="Test MSE ($10^{-4}$ squared normalised units)")
    axes.set_xlim(-0.4, len(runs.columns) - 0.6)
    axes.set_xticks(range(len(runs.columns)), labels)
    plain_log_ticks(axes.yaxis)
    axes.grid(axis="y", which="both")
    return figure
