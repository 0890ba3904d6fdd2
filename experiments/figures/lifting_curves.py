"""Figures of the lifting network: errors by pose, noise and missing landmarks, and calibration."""

from __future__ import annotations

import matplotlib
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, StrMethodFormatter

from experiments.figures.style import INK, colour, marker, styled
from experiments.methods import title

_UNIT = 1e-6
_LIMIT = "limit"
_ERROR = "MSE ($10^{-6}$ squared min-max units)"


@styled
def errors_by_yaw(curves: pd.DataFrame) -> Figure:
    """Error against yaw to either side, a curve a method; below the limit nothing can be.

    Args:
        curves: `method`, `yaw` (degrees), `mean` and `standard_error` of one condition.
    """
    figure = Figure(figsize=(5.2, 3.4), layout="constrained")
    axes = figure.subplots()
    for method, own in curves.groupby("method", sort=False):
        _draw(axes, own["yaw"], own, method)
    axes.set(xlabel="Yaw to either side (degrees)", ylabel=_ERROR)
    _finish(figure, [axes])
    return figure


@styled
def errors_by_condition(sweeps: dict[str, pd.DataFrame]) -> Figure:
    """Error against noise and against missing landmarks, a panel each.

    Args:
        sweeps: Label of the axis to `method`, `value`, `mean` and `standard_error`.
    """
    figure = Figure(figsize=(7.2, 3.2), layout="constrained")
    panels = figure.subplots(1, len(sweeps), sharey=True)
    for axes, (label, rows) in zip(panels, sweeps.items(), strict=True):
        for method, own in rows.groupby("method", sort=False):
            _draw(axes, own["value"], own, method)
        axes.set(xlabel=label, xticks=sorted({*rows["value"]}))
    panels[0].set_ylabel(_ERROR)
    _finish(figure, panels)
    return figure


@styled
def reliability(levels: pd.DataFrame) -> Figure:
    """Share of the true coordinates within intervals, against the probability of these.

    Args:
        levels: `method`, `condition` (its title), `nominal` and `observed`.
    """
    methods = levels["method"].unique()
    figure = Figure(figsize=(3.4 * len(methods), 3.4), layout="constrained")
    panels = figure.subplots(1, len(methods), sharey=True, squeeze=False)[0]
    for axes, method in zip(panels, methods, strict=True):
        axes.plot([0, 1], [0, 1], color=INK, lw=0.7, ls=(0, (4, 2)))
        own = levels[levels["method"] == method]
        n = own["condition"].nunique()
        for place, (condition, rows) in enumerate(own.groupby("condition", sort=False)):
            axes.plot(
                rows["nominal"], rows["observed"], label=condition, lw=0.9,
                color=matplotlib.colormaps["viridis"](place / n), marker="osD^vph"[place % 7],
                ms=2.5, mew=0,
            )  # fmt: skip
        axes.set(xlabel="Nominal share", title=title(method), xlim=(0, 1), ylim=(0, 1))
        axes.set_aspect("equal")
        axes.grid()
    panels[0].set_ylabel("Share of true coordinates")
    panels[-1].legend(loc="lower right")
    return figure


def _draw(axes: Axes, x: pd.Series, rows: pd.DataFrame, method: str) -> None:
    mean, half = rows["mean"] / _UNIT, 1.96 * rows["standard_error"] / _UNIT
    ink, is_limit = colour(method), method == _LIMIT
    style = {"ls": (0, (4, 2))} if is_limit else {"marker": marker(method), "ms": 3.5, "mew": 0}
    axes.fill_between(x, mean - half, mean + half, color=ink, alpha=0.18, lw=0)
    axes.plot(x, mean, color=ink, lw=0.9, label=title(method), **style)


def _finish(figure: Figure, panels) -> None:
    for axes in panels:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.grid()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper")
