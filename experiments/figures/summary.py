"""The headline figure, every method beside the paper's number, and the spread over seeds."""

from __future__ import annotations

import textwrap

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter

from experiments.figures.style import INK, colour, marker, styled
from experiments.methods import title
from experiments.metrics import METRICS
from experiments.published import unit_of
from experiments.scoring.numbers import as_quoted, between, plus_minus
from experiments.scoring.typesetting import head_of, n_landmarks

_MSE_UNIT = 1e-4
_SYMBOLS, _LETTER = 1.05, 0.045  # inches of a panel of symbols, and of a letter beside it


@styled
def summary(table: pd.DataFrame, experiment: str) -> Figure:
    """MSE and missing depth correlation of every method, filled ours, hollow the paper's.

    The depth correlation is a trace, whose greatest value is the number of landmarks; what is
    missing from it is drawn, because the values themselves differ in the fourth digit only.

    Args:
        table: `method` (id), `metric` (`"mse"`, `"depth_corr"`), `mean`, `std`, `paper_mean`,
            `paper_std`; NaN where there is no number. Over seeds `n_seeds`, `median`, `lowest` and
            `highest`, if it has them.
        experiment: `"bfm"`, `"celeba"` or `"flame"`: which of the paper's tables it stands beside.
    """
    most = n_landmarks(experiment)
    over_seeds = "n_seeds" in table
    if not over_seeds:
        table = table.assign(median=np.nan, lowest=np.nan, highest=np.nan)
    methods = list(dict.fromkeys(table["method"]))
    mse, depth_corr = (
        table[table["metric"] == metric].set_index("method") for metric in ("mse", "depth_corr")
    )
    columns = [
        _columns(rows.reindex(methods), unit_of(experiment, metric))
        for rows, metric in ((mse, "mse"), (depth_corr, "depth_corr"))
    ]
    letters = [[max(map(len, texts)) + 2 for texts in own] for own in columns]
    figure = Figure(figsize=(7.2, 1.0 + 0.26 * len(methods)), layout="constrained")
    widths = [width for own in letters for width in (_SYMBOLS, _LETTER * sum(own))]
    panels = figure.subplots(1, 4, sharey=True, gridspec_kw={"width_ratios": widths})
    figure.get_layout_engine().set(w_pad=0.03, wspace=0)
    lost = most - depth_corr["paper_mean"]
    # The paper prints values above the greatest one for the FLAME landmarks: in the text only.
    missing = depth_corr.assign(
        mean=most - depth_corr["mean"],
        paper_mean=lost.where(lost >= 0),
        **{name: most - depth_corr[name] for name in ("median", "lowest", "highest")},
    )
    for axes, rows, name in (
        (panels[0], mse, "MSE (squared normalised units)"),
        (panels[2], missing, f"{most} − depth correlation (no unit)"),
    ):
        _markers(axes, rows.reindex(methods))
        axes.set_xlabel(f"{name}\n← better")
    for k, metric in enumerate(("mse", "depth_corr")):
        middle = letters[k][0] / sum(letters[k])
        _numbers(panels[2 * k + 1], *columns[k], middle, head_of(METRICS[metric], experiment))
    panels[0].set_yticks(range(len(methods)), [title(method) for method in methods])
    panels[0].set_ylim(len(methods) - 0.5, -0.5)
    dot = {"color": INK, "marker": "o", "ms": 5}
    handles = [Line2D([], [], **dot, lw=0.9, label="this work, mean ± s.d.")]
    if over_seeds:
        label = f"over {table['n_seeds'].max():.0f} seeds, median and range"
        handles.append(Line2D([], [], **dot, lw=3, alpha=0.6, label=label))
    handles.append(Line2D([], [], **dot, mfc="white", lw=0, label="as published"))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


def _markers(axes: Axes, rows: pd.DataFrame) -> None:
    """One row per method: filled, our mean with its s.d., or our median and the range over seeds;
    hollow, the published mean.
    """
    axes.set_xscale("log", nonpositive="clip")
    axes.xaxis.set_minor_formatter(NullFormatter())  # over few decades they would overlap
    for y, row in enumerate(rows.itertuples()):
        look = {"color": colour(row.Index), "marker": marker(row.Index), "linestyle": "none"}
        axes.plot(row.paper_mean, y, **look, ms=6.5, mfc="none", mew=0.9)
        if np.isnan(row.median):
            axes.errorbar(row.mean, y, xerr=row.std, **look, ms=4.5, mew=0, elinewidth=1)
        else:
            axes.plot([row.lowest, row.highest], [y, y], color=colour(row.Index), lw=3, alpha=0.45)
            axes.plot(row.median, y, **look, ms=4.5, mew=0)
    _stripes(axes, len(rows))
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x")
    axes.margins(x=0.1)


def _columns(rows: pd.DataFrame, unit: float) -> tuple[list[str], list[str]]:
    """The numbers of this work and of the paper, as text."""
    ours = [
        plus_minus(row.mean, row.std, unit) if np.isnan(row.median)
        else between(row.median, row.lowest, row.highest, unit)
        for row in rows.itertuples()
    ]  # fmt: skip
    paper = zip(rows["paper_mean"], rows["paper_std"], strict=True)
    return ours, [as_quoted(*of, unit) for of in paper]


def _numbers(axes: Axes, ours: list[str], published: list[str], middle: float, name: str) -> None:
    """The same numbers as text, in the same rows, ours up to the middle."""
    axes.set_axis_off()
    _stripes(axes, len(ours))
    axes.set(xlim=(0, 1), title=f"{name}\n")
    for x, head, texts in ((middle, "this work", ours), (0.99, "published", published)):
        axes.text(x, -0.6, head, ha="right", va="bottom", size=6.5, color=INK)
        for y, text in enumerate(texts):
            axes.text(x, y, text, ha="right", va="center", size=5.8, color=INK)


def _stripes(axes: Axes, n_rows: int) -> None:
    for y in range(0, n_rows, 2):
        axes.axhspan(y - 0.5, y + 0.5, color="#F5F5F5", lw=0, zorder=0)


@styled
def seed_spread(table: pd.DataFrame) -> Figure:
    """MSE of every training run, a dot a seed, with runs of the same seed joined.

    Args:
        table: One row a run: `method` (id), `seed`, `metric` (only `"mse"` is drawn), `value` in
            squared normalised units.
    """
    runs = table[table["metric"] == "mse"].pivot(index="seed", columns="method", values="value")
    methods = [method for method in dict.fromkeys(table["method"]) if method in runs]
    runs = runs[methods]
    figure = Figure(figsize=(1.6 + 1.0 * len(methods), 3.0), layout="constrained")
    axes = figure.subplots()
    for values in runs.to_numpy():
        axes.plot(range(len(methods)), values, color="#CCCCCC", linewidth=0.6, zorder=1)
    for x, method in enumerate(methods):
        values = runs[method].dropna()
        axes.plot(
            np.full(len(values), x),
            values,
            linestyle="none",
            marker=marker(method),
            markersize=5,
            markeredgecolor="white",
            markeredgewidth=0.5,
            color=colour(method),
        )
        median = values.median()
        axes.plot([x - 0.16, x + 0.16], [median, median], color=INK, linewidth=1.2, zorder=3)
        axes.annotate(
            f"median\n{median / _MSE_UNIT:#.3g}$\\times 10^{{-4}}$",
            (x + 0.2, median),
            va="center",
            size=6.5,
            color=INK,
        )
    axes.set(yscale="log", ylabel="Test MSE (squared normalised units)")
    axes.set_xlim(-0.4, len(methods) - 0.2)
    axes.set_xticks(
        range(len(methods)),
        [f"{textwrap.fill(title(m), 18)}\n({runs[m].count()} seeds)" for m in methods],
    )
    axes.grid(axis="y", which="both")
    return figure
