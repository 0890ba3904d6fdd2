"""Errors against pose, noise, condition or region: one line per method, with intervals."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from pandas.api.types import is_numeric_dtype

from deepmds_keras.landmarks import LandmarkScheme
from experiments.figures.style import INK, Look, drawn, look, method_legend, styled
from experiments.figures.wireframe import draw_error_map
from experiments.methods import title
from experiments.scoring.numbers import minus, power

_SHADE = "#FFF3D0"
_BAND = 0.18  # opacity
_MOST_TICKS = 8  # up to so many values on an axis each get a tick
_N_BINS = 9
_PLAIN = ticker.FuncFormatter(lambda value, _: minus(f"{value:,g}"))


@dataclass(frozen=True, eq=False)
class Panel:
    """One pair of axes of `error_lines`.

    Attributes:
        rows: A row per point: `method` (id), `mean`, and its standard error `sem`, or the ends
            `low` and `high` of an interval, or neither.
        x: Column of `rows` for the x axis; strings are categories, not joined by lines.
        label: Label of the x axis, with its unit; none if its categories explain themselves.
        shaded: Range of x in the training views, which is shaded.
    """

    rows: pd.DataFrame
    x: str
    label: str = ""
    title: str = ""
    log_x: bool = False
    shaded: tuple[float, float] | None = None


@styled
def error_lines(
    panels: Sequence[Panel],
    quantity: str = "MSE of a face",
    unit: float = 1e-4,
    units: str = "squared normalised units",
    *,
    looks: Mapping[str, Look] = {},
    interval: str = "95 % interval over faces",
    n_columns: int | None = None,
    log_y: bool = True,
) -> Figure:
    """Means against x, one line per method, with intervals.

    Args:
        unit: Power of ten in which the y axis counts, of `units`.
        units: Unit of `mean` in the rows of the panels.
        looks: Looks of ids in `method` that are not methods of the tables.
        n_columns: Columns of the grid of panels; None puts all in one row.
        log_y: Whether the y axis is logarithmic; otherwise it begins at 0.
    """
    n_columns = n_columns or len(panels)
    n_rows = -(-len(panels) // n_columns)
    figure = Figure(figsize=(7.2, 0.8 + 2.3 * n_rows), layout="constrained")
    grid = figure.subplots(n_rows, n_columns, sharey=True, squeeze=False)
    for axes, panel in zip(grid.flat, panels, strict=True):
        _draw_panel(axes, panel, unit, looks)
    counted = "" if unit == 1 else f"{power(unit)} "
    for axes in grid[:, 0]:
        axes.set_ylabel(f"{quantity}\n({counted}{units})")
    if log_y:
        plain_log_ticks(grid[0, 0].yaxis)
    else:
        grid[0, 0].set(yscale="linear", ylim=(0, None))
    methods = dict.fromkeys(method for panel in panels for method in panel.rows["method"])
    joined = any(is_numeric_dtype(panel.rows[panel.x]) for panel in panels)
    more = []
    if any({"low", "sem"} & {*panel.rows} for panel in panels):
        bar = {"ls": "", "marker": "|", "ms": 9, "mew": 0.9}
        handle = Patch(facecolor=INK, alpha=_BAND) if joined else Line2D([], [], color=INK, **bar)
        handle.set_label(interval)
        more.append(handle)
    if any(panel.shaded for panel in panels):
        more.append(Patch(facecolor=_SHADE, label="training views"))
    method_legend(figure, methods, more, looks, joined)
    return figure


def _draw_panel(
    axes: Axes, panel: Panel, unit: float = 1.0, looks: Mapping[str, Look] = {}
) -> None:
    """Draw all of a panel but its y label, y ticks and legend."""
    if panel.shaded:
        # For a single value it is as wide as a line.
        axes.axvspan(*panel.shaded, facecolor=_SHADE, edgecolor=_SHADE, lw=2)
    x = panel.rows[panel.x]
    if is_numeric_dtype(x):
        _draw_curves(axes, panel, unit, looks)
        if panel.log_x:
            axes.set_xscale("log")
            axes.xaxis.set_minor_locator(ticker.NullLocator())
        if x.nunique() <= _MOST_TICKS and (x == x.round(2)).all():
            axes.set_xticks(sorted(x.unique()))
        axes.margins(x=0.02)
        axes.xaxis.set_major_formatter(_PLAIN)
    else:
        _draw_categories(axes, panel, unit, looks)
    axes.set(yscale="log", xlabel=panel.label, title=panel.title)
    axes.grid(axis="y")


def _draw_curves(axes: Axes, panel: Panel, unit: float, looks: Mapping[str, Look]) -> None:
    for method, rows in panel.rows.groupby("method", sort=False):
        style = drawn(look(method, looks))
        rows = rows.sort_values(panel.x)
        x, (low, high) = rows[panel.x], _interval(rows)
        band = axes.fill_between(x, low / unit, high / unit, color=style["color"], lw=0.5)
        band.set_alpha(_BAND)
        band.set_edgecolor(style["color"])  # which parts bands that cover each other
        axes.plot(x, rows["mean"] / unit, **style)


def _draw_categories(axes: Axes, panel: Panel, unit: float, looks: Mapping[str, Look]) -> None:
    names = list(panel.rows[panel.x].unique())
    methods = panel.rows.groupby("method", sort=False)
    # Methods stand side by side, so that equal errors do not hide each other.
    shifts = 0.64 * ((np.arange(len(methods)) + 0.5) / len(methods) - 0.5)
    for shift, (method, rows) in zip(shifts, methods, strict=True):
        style = drawn(look(method, looks), joined=False)
        x, mean, (low, high) = rows[panel.x].map(names.index), rows["mean"], _interval(rows)
        ends = np.stack([mean - low, high - mean]) / unit
        axes.errorbar(x + shift, mean / unit, yerr=ends, elinewidth=0.7, **style)
    axes.set_xticks(range(len(names)), names)
    axes.set_xlim(-0.5, len(names) - 0.5)
    axes.tick_params(axis="x", length=0)
    for edge in np.arange(len(names) - 1) + 0.5:
        axes.axvline(edge, color="#E3E3E3", lw=0.5)


def _interval(rows: pd.DataFrame) -> tuple[pd.Series, pd.Series]:
    """Ends of the interval about each mean."""
    if "low" in rows:
        return rows["low"], rows["high"]
    half = 1.96 * rows["sem"].fillna(0) if "sem" in rows else 0 * rows["mean"]
    return rows["mean"] - half, rows["mean"] + half


def plain_log_ticks(axis: Axis) -> None:
    """Plain numbers on a logarithmic axis: 1, 2 and 5 of each decade, or 1 if there are many.

    Over more decades than there is room for, a few powers of ten.
    """
    low, high = axis.get_view_interval()
    decades = np.log10(high / low)
    axis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5) if decades < 3 else (1,), numticks=6))
    axis.set_major_formatter(_PLAIN if decades < 6 else ticker.LogFormatterMathtext())
    axis.set_minor_formatter(ticker.NullFormatter())


def mean_errors(errors: pd.DataFrame, x: str) -> pd.DataFrame:
    """Mean and standard error of `mse` by method and x, as a `Panel` draws them."""
    return errors.groupby(["method", x], sort=False)["mse"].agg(["mean", "sem"]).reset_index()


def level(x: pd.Series, method: str, value: float) -> pd.DataFrame:
    """Rows of a `Panel` that draw a line at a value, from the least x to the largest."""
    ends = x.agg(["min", "max"]).rename(x.name).to_frame()
    return ends.assign(method=method, mean=value, low=value, high=value)


def error_per_pose(errors: pd.DataFrame, unit: float = 1e-4) -> Figure:
    """Mean error of a face against its pose.

    Args:
        errors: One row per face and method: `method` (id), `projection` (`"orthographic"` or
            `"perspective"`), `yaw` and `pitch` of the face in degrees as in
            `data_gen.views.Cameras`, `mse` in squared normalised units.
        unit: Power of ten in which the y axis counts.
    """
    methods = pd.Categorical(errors["method"], errors["method"].unique())
    errors = errors.assign(method=methods).sort_values(["method", "projection", "yaw"])
    orthographic = errors["projection"] == "orthographic"
    names = errors["yaw"].map(lambda yaw: minus(f"orth.\n{yaw:g}°"))
    kinds = errors.assign(kind=names.where(orthographic, "persp.\nall"))
    panels = [Panel(mean_errors(kinds, "kind"), "kind", "", "By projection and yaw")]
    for angle in ("yaw", "pitch"):
        rows = errors[~orthographic]
        edges = np.linspace(rows[angle].min(), rows[angle].max(), _N_BINS + 1)
        bins = np.clip(np.digitize(rows[angle], edges) - 1, 0, _N_BINS - 1)
        binned = rows.assign(**{angle: (edges[:-1] + edges[1:])[bins] / 2})
        label = f"{angle.capitalize()} of the face (°)"
        panels.append(Panel(mean_errors(binned, angle), angle, label, f"Perspective, by {angle}"))
    return error_lines(panels, unit=unit)


@styled
def error_distribution(errors: Mapping[str, np.ndarray]) -> Figure:
    """Cumulative distribution of the mean squared errors `(n,)` of the same faces, by method id."""
    figure = Figure(figsize=(3.5, 2.6), layout="constrained")
    axes = figure.subplots()
    shares = np.linspace(0, 1, 501)
    for method, values in errors.items():
        style = drawn(look(method))
        axes.plot(np.quantile(values, shares), shares, label=title(method), markevery=0.12, **style)
    axes.set_xscale("log")
    axes.set(xlabel="MSE (squared normalised units)", ylabel="Share of faces below", ylim=(0, 1))
    axes.yaxis.set_major_formatter(ticker.PercentFormatter(1))
    axes.grid()
    axes.legend()
    return figure


@styled
def error_per_landmark(
    errors: Mapping[str, np.ndarray],
    scheme: LandmarkScheme,
    mean_shape: np.ndarray,
    maps: Sequence[str],
) -> Figure:
    """Faces coloured by error for a few methods; below, the errors of all methods by region.

    Args:
        errors: Method id to `(L,)` root-mean-square distances to the truth in millimetres.
        mean_shape: `(L, 3)` in any unit, where the landmarks are drawn.
        maps: Method ids to draw as faces.
    """
    figure = Figure(figsize=(7.2, 4.8), layout="constrained")
    faces, regions = figure.subfigures(2, 1, height_ratios=(1, 1.5))
    shown = np.concatenate([errors[method] for method in maps])
    colours = ScalarMappable(LogNorm(shown.min(), shown.max()), "viridis_r")
    panels = faces.subplots(1, len(maps), squeeze=False)[0]
    for axes, method in zip(panels, maps, strict=True):
        draw_error_map(axes, mean_shape, scheme.polylines, errors[method], colours)
        axes.set_title(textwrap.fill(title(method), 14))
    bar = faces.colorbar(colours, ax=panels, shrink=0.8, pad=0.01, aspect=14, panchor=False)
    bar.set_label("R.m.s. error (mm)")
    plain_log_ticks(bar.ax.yaxis)

    sizes = pd.Series(scheme.groups).value_counts()
    names = [f"{name.replace('_', chr(10))}\n({sizes[name]})" for name in scheme.groups]
    by_region = pd.DataFrame(errors).pow(2).groupby(names, sort=False).mean().pow(0.5)
    # From the brows down, the right and the left of a part side by side.
    parts = [name.removeprefix("right_").removeprefix("left_") for name in scheme.groups]
    heights = pd.Series(mean_shape[:, 1]).groupby(parts).mean()
    order = dict(zip(names, heights.loc[parts], strict=True))
    rows = by_region.loc[sorted(order, key=order.get, reverse=True)].rename_axis("region")
    rows = rows.reset_index().melt("region", var_name="method", value_name="mean")
    axes = regions.subplots()
    _draw_panel(axes, Panel(rows, "region", "Region (landmarks)"))
    axes.set_ylabel("R.m.s. error over\nthe region (mm)")
    plain_log_ticks(axes.yaxis)
    method_legend(regions, errors, joined=False)
    return figure
