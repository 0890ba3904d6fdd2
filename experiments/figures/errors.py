"""Where the errors are: over the landmarks of the face, and over the poses of the view."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.axis import Axis
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, PercentFormatter

from experiments.figures.style import INK, TRUTH_COLOUR, colour, marker, styled
from experiments.figures.wireframe import bare, draw_wireframe, front_view
from experiments.methods import title

if TYPE_CHECKING:
    from deepmds_keras.landmarks import LandmarkScheme

_N_MAPS = 4
_N_BINS = 9
_N_SHARES = 501
_PLAIN = FuncFormatter(lambda value, _: f"{value:g}")


@styled
def error_per_landmark(
    errors: Mapping[str, np.ndarray],
    scheme: LandmarkScheme,
    mean_shape: np.ndarray,
    maps: Sequence[str] | None = None,
) -> Figure:
    """The face coloured by error for a few methods, above all methods' errors by region.

    Args:
        errors: Method id to `(L,)` root-mean-square distances to the truth in millimetres.
        scheme: Landmark scheme, for its polylines and groups.
        mean_shape: `(L, 3)` in any unit, where the landmarks are drawn.
        maps: Method ids to draw as faces; None takes the first four.
    """
    maps = list(errors)[:_N_MAPS] if maps is None else list(maps)
    figure = Figure(figsize=(7.2, 5.0), layout="constrained")
    faces, regions = figure.subfigures(2, 1, height_ratios=(1, 1.4))

    shown = np.concatenate([errors[method] for method in maps])
    norm = LogNorm(shown.min(), shown.max())
    colours = ScalarMappable(norm, "viridis_r")
    points = front_view(mean_shape)
    pad = 0.05 * np.ptp(points[:, 1])
    extent = (
        *(points[:, 0].min() - pad, points[:, 0].max() + pad),
        *(points[:, 1].min() - pad, points[:, 1].max() + pad),
    )
    panels = faces.subplots(1, len(maps), squeeze=False)[0]
    for axes, method in zip(panels, maps, strict=True):
        bare(axes, extent)
        draw_wireframe(axes, points, scheme.polylines, colour=TRUTH_COLOUR, dot_area=0)
        axes.scatter(
            *points.T,
            s=15,
            c=colours.to_rgba(errors[method]),
            edgecolors=INK,
            linewidths=0.3,
            zorder=3,
        )
        axes.set_title("\n".join(textwrap.wrap(title(method), 14)))
    bar = faces.colorbar(colours, ax=panels, shrink=0.8, pad=0.01, aspect=14, panchor=False)
    bar.set_label("R.m.s. error (mm)")
    _plain_log_ticks(bar.ax.yaxis)

    axes = regions.subplots()
    groups = np.asarray(scheme.groups)
    by_group = pd.DataFrame(
        {
            method: {group: _rms(values[groups == group]) for group in dict.fromkeys(groups)}
            for method, values in errors.items()
        }
    )
    by_group = by_group.loc[np.log(by_group).mean(axis=1).sort_values().index]
    # Methods of one region sit a little apart, so that equal errors do not hide each other.
    offsets = np.linspace(0.3, -0.3, len(errors)) if len(errors) > 1 else [0.0]
    for offset, method in zip(offsets, by_group, strict=True):
        axes.plot(
            by_group[method],
            np.arange(len(by_group)) + offset,
            linestyle="none",
            marker=marker(method),
            markersize=4.5,
            markeredgewidth=0,
            color=colour(method),
            label=title(method),
        )
    for edge in np.arange(len(by_group) - 1) + 0.5:
        axes.axhline(edge, color="#E3E3E3", linewidth=0.5)
    sizes = pd.Series(groups).value_counts()
    axes.set(
        xscale="log",
        xlabel="R.m.s. error over the landmarks of the region (mm)",
        ylim=(-0.5, len(by_group) - 0.5),
    )
    axes.set_yticks(
        range(len(by_group)),
        [f"{group.replace('_', ' ')} ({sizes[group]})" for group in by_group.index],
    )
    axes.tick_params(axis="y", length=0)
    _plain_log_ticks(axes.xaxis)
    axes.grid(axis="x")
    axes.legend(loc="center left", bbox_to_anchor=(1, 0.5), handletextpad=0.2)
    return figure


@styled
def error_per_pose(errors: pd.DataFrame) -> Figure:
    """Mean error of a face against its pose, with 95 % confidence intervals of the mean.

    Args:
        errors: One row per face and method: `method` (id), `projection` (`"orthographic"` or
            `"perspective"`), `yaw` and `pitch` of the face in degrees as in
            `data_gen.views.projections.Cameras`, `mse` in squared normalised units.
    """
    methods = list(dict.fromkeys(errors["method"]))
    figure = Figure(figsize=(7.2, 3.3), layout="constrained")
    kinds, yaw_panel, pitch_panel = figure.subplots(1, 3, sharey=True)

    orthographic = errors[errors["projection"] == "orthographic"]
    perspective = errors[errors["projection"] == "perspective"]
    yaws = sorted(orthographic["yaw"].unique())
    names = [f"{yaw:g}°".replace("-", "−") for yaw in yaws] + ["persp.\n(all)"]
    offsets = np.linspace(-0.28, 0.28, len(methods)) if len(methods) > 1 else [0.0]
    for offset, method in zip(offsets, methods, strict=True):
        own = orthographic[orthographic["method"] == method]
        cells = [own.loc[own["yaw"] == yaw, "mse"] for yaw in yaws]
        cells.append(perspective.loc[perspective["method"] == method, "mse"])
        kinds.errorbar(
            np.arange(len(cells)) + offset,
            [cell.mean() for cell in cells],
            yerr=[_half_interval(cell) for cell in cells],
            fmt=marker(method),
            color=colour(method),
            markersize=4,
            markeredgewidth=0,
            elinewidth=0.7,
        )
    kinds.axvline(len(yaws) - 0.5, color="#BBBBBB", linewidth=0.6, linestyle=":")
    kinds.set_xticks(range(len(names)), names)
    kinds.set(
        title="Projection",
        xlabel="Yaw (°), orthographic",
        yscale="log",
        xlim=(-0.5, len(yaws) + 0.5),
    )
    kinds.set_ylabel("MSE of a face\n(squared normalised units)")

    for axes, angle in ((yaw_panel, "yaw"), (pitch_panel, "pitch")):
        edges = np.linspace(perspective[angle].min(), perspective[angle].max(), _N_BINS + 1)
        centres = (edges[:-1] + edges[1:]) / 2
        bins = np.clip(np.digitize(perspective[angle], edges) - 1, 0, _N_BINS - 1)
        binned = perspective.groupby(["method", bins])["mse"]
        means, halves = binned.mean(), binned.agg(_half_interval)
        for method in methods:
            mean = means[method].reindex(range(_N_BINS)).to_numpy()
            half = halves[method].reindex(range(_N_BINS)).to_numpy()
            axes.plot(
                centres,
                mean,
                color=colour(method),
                marker=marker(method),
                markersize=3.5,
                markeredgewidth=0,
                lw=0.9,
            )
            axes.fill_between(
                centres, mean - half, mean + half, color=colour(method), alpha=0.18, lw=0
            )
        axes.set(title=f"Perspective, by {angle}", xlabel=f"{angle.capitalize()} of the face (°)")
    for axes in (kinds, yaw_panel, pitch_panel):
        axes.grid(axis="y")
    figure.legend(
        handles=[
            Line2D([], [], color=colour(m), marker=marker(m), ms=4, mew=0, lw=0.9, label=title(m))
            for m in methods
        ],
        loc="outside lower center",
        ncols=4,
        columnspacing=1.2,
    )
    return figure


@styled
def error_per_condition(errors: pd.DataFrame) -> Figure:
    """Mean error of a face by what its scan shows, with 95 % confidence intervals of the mean.

    Args:
        errors: One row per face and method: `method` (id), `condition` (name), `mse` in squared
            normalised units, NaN where the method found no face.
    """
    methods = list(dict.fromkeys(errors["method"]))
    conditions = list(dict.fromkeys(errors["condition"]))
    figure = Figure(figsize=(7.2, 3.0), layout="constrained")
    axes = figure.subplots()
    groups = errors.dropna().groupby(["method", "condition"])["mse"]
    means, halves = groups.mean(), groups.agg(_half_interval)
    offsets = np.linspace(-0.32, 0.32, len(methods)) if len(methods) > 1 else [0.0]
    for offset, method in zip(offsets, methods, strict=True):
        axes.errorbar(
            np.arange(len(conditions)) + offset,
            means[method].reindex(conditions),
            yerr=halves[method].reindex(conditions),
            fmt=marker(method),
            color=colour(method),
            markersize=4,
            markeredgewidth=0,
            elinewidth=0.7,
            label=title(method),
        )
    for edge in np.arange(len(conditions) - 1) + 0.5:
        axes.axvline(edge, color="#E3E3E3", linewidth=0.5)
    axes.set(yscale="log", xlim=(-0.5, len(conditions) - 0.5))
    axes.set_ylabel("MSE of a face\n(squared normalised units)")
    axes.set_xticks(range(len(conditions)), [name.replace("_", " ") for name in conditions])
    axes.tick_params(axis="x", length=0)
    axes.grid(axis="y")
    axes.legend(loc="center left", bbox_to_anchor=(1, 0.5), handletextpad=0.2)
    return figure


@styled
def error_distribution(errors: Mapping[str, np.ndarray]) -> Figure:
    """Share of the faces that have a smaller error, for every error.

    Args:
        errors: Method id to `(n,)` mean squared errors of the same faces.
    """
    figure = Figure(figsize=(3.5, 2.6), layout="constrained")
    axes = figure.subplots()
    shares = np.linspace(0, 1, _N_SHARES)
    for method, values in errors.items():
        look = {"color": colour(method), "marker": marker(method), "markevery": 0.12, "ms": 4}
        axes.plot(np.quantile(values, shares), shares, label=title(method), **look)
    axes.set_xscale("log")
    axes.set(xlabel="MSE (squared normalised units)", ylabel="Share of faces below", ylim=(0, 1))
    axes.yaxis.set_major_formatter(PercentFormatter(1))
    axes.grid()
    axes.legend()
    return figure


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _half_interval(values: pd.Series) -> float:
    """Half width of the 95 % confidence interval of the mean, by the normal approximation."""
    return 1.96 * values.sem() if len(values) > 1 else 0.0


def _plain_log_ticks(axis: Axis) -> None:
    """Ticks at 1, 2 and 5 of each decade, written as plain numbers."""
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(_PLAIN)
    axis.set_minor_formatter(FuncFormatter(lambda *_: ""))
