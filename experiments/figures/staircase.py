"""Figure of the anatomy: the error step by step, from the method down to the limit."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from experiments.figures.style import INK, TRUTH_COLOUR, colour, marker, styled
from experiments.scoring.numbers import rounded

_UNIT = 1e-6
_NOTHING = 1e-6  # of it: an error that is rounding
_FLOOR = 0.3  # of the limit: what lies below it is drawn there, with its number
# Embedding to method whose look it has, and legend.
_LOOKS = {
    "non_metric": ("ours", "non-metric MDS, as the method"),
    "metric": ("linear", "metric MDS"),
}


@styled
def staircase(table: pd.DataFrame, titles: Mapping[str, str]) -> Figure:
    """Mean squared error after each replacement, with the mean shape and the limit as lines.

    Args:
        table: `step`, `embedding` (`"non_metric"`, `"metric"`, or `"none"` of the lines), `mse` and
            its standard error `sem`, in squared normalised units.
        titles: Step to its name.
    """
    steps = list(dict.fromkeys(table.loc[table["embedding"] != "none", "step"]))
    figure = Figure(figsize=(7.2, 3.4), layout="constrained")
    axes = figure.subplots()
    lines = table[table["embedding"] == "none"].set_index("step")["mse"] / _UNIT
    floor = _FLOOR * lines["limit"]
    for step, dashes in (("mean_shape", (0, (1, 1.2))), ("limit", (0, (4, 2)))):
        axes.axhline(lines[step], color=INK, lw=0.9, ls=dashes, label=titles[step].split(":")[0])
    axes.axhspan(floor, lines["limit"], color=TRUTH_COLOUR, alpha=0.25, lw=0)
    places = np.arange(len(steps))
    for (kind, (look, legend)), side in zip(_LOOKS.items(), (-1, 1), strict=True):
        own = table[table["embedding"] == kind].set_index("step").loc[steps]
        mse, sem = own["mse"] / _UNIT, own["sem"] / _UNIT
        if kind == "non_metric":
            axes.stairs(mse.clip(lower=floor), np.arange(len(steps) + 1) - 0.5,
                        baseline=None, color=colour(look), lw=1.0, alpha=0.5)  # fmt: skip
        drawn = mse.clip(lower=floor)
        axes.errorbar(
            places + 0.16 * side, drawn, yerr=np.where(mse < floor, 0, sem), label=legend,
            color=colour(look), marker=marker(look), ms=4.5, mew=0, ls="none", elinewidth=1,
        )  # fmt: skip
        for place, height, value in zip(places + 0.16 * side, drawn, mse, strict=True):
            axes.annotate(_quoted(value), (place, height), xytext=(0, 6), ha="center", size=6.5,
                          textcoords="offset points", color=INK,
                          bbox={"fc": "white", "ec": "none", "pad": 0.3})  # fmt: skip
    axes.set(yscale="log", ylabel="MSE ($10^{-6}$ squared normalised units)")
    axes.set_xticks(places, [textwrap.fill(titles[step], 18) for step in steps])
    axes.set_xlim(-0.5, len(steps) - 0.5)
    axes.set_ylim(bottom=0.8 * floor)
    axes.tick_params(axis="x", length=0)
    axes.grid(axis="y")
    figure.legend(loc="outside upper center", ncols=4)
    return figure


def _quoted(value: float) -> str:
    return "0" if value < _NOTHING else rounded(value)
