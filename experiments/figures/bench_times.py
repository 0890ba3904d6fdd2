"""Figure of `make bench`: time per face by part and way, and how it grows."""

from __future__ import annotations

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter, NullLocator

from experiments.figures.style import INK, colour, marker, styled
from experiments.methods import title
from experiments.scoring.numbers import factor

_OTHER = "lifting"  # a method of its own
# Ways by colour and marker, parts by dashes; "ours" and the batched solver are both ours.
_WAYS = {
    "released": ("released way", "#777777", "s"),
    "sklearn": ("scikit-learn's solver", "#0072B2", "^"),
    "ours": ("ours", "#D55E00", "o"),
    "batched": ("ours, batched solver", "#D55E00", "o"),
    _OTHER: (title(_OTHER), colour(_OTHER), marker(_OTHER)),
}
_PARTS = {
    "data generation": ("#009E73", "D"),
    "pair features": ("#CC79A7", "v"),
    "prediction": ("#0072B2", "s"),
    "embedding": ("#D55E00", "o"),
    "end to end": ("#222222", "^"),
}
_DASHES = {"released": (0, (1, 1.2)), "sklearn": (0, (4, 2)), "ours": "-", "batched": "-"}
_PLAIN = FuncFormatter(lambda value, _: f"{value:,g}")


@styled
def bench(table: pd.DataFrame) -> Figure:
    """Four panels: parts, faces, landmarks and processes.

    Args:
        table: As from `experiments.bench.measurements.table_of`; rows without a time are left out.
    """
    rows = table[table["seconds"].notna()]
    figure = Figure(figsize=(7.2, 6.0), layout="constrained")
    panels = figure.subplots(2, 2)
    _draw_parts(panels[0, 0], rows[rows["comparison"] == "parts"])
    _draw_growth(panels[0, 1], rows[rows["comparison"] == "faces"], "n_faces", "seconds")
    _draw_growth(panels[1, 0], rows[rows["comparison"] == "landmarks"], "n_landmarks",
                 "ms_per_face")  # fmt: skip
    _draw_jobs(panels[1, 1], rows[rows["comparison"] == "jobs"])
    panels[0, 0].set(title="Parts, on one core", xlabel="Time per face (ms)")
    panels[0, 1].set(title="Growth with faces", xlabel="Faces", ylabel="Total time (s)")
    panels[1, 0].set(title="Growth with landmarks", xlabel="Landmarks", ylabel="Time per face (ms)")
    panels[1, 1].set(title="Growth with processes", xlabel="Processes")
    panels[1, 1].set_ylabel("Speed-up over one process")
    _legends(figure, rows)
    return figure


def _draw_parts(axes: Axes, rows: pd.DataFrame) -> None:
    parts = [part for part in _PARTS if part in set(rows["part"])]
    for height, part in enumerate(parts):
        own = rows[rows["part"] == part].set_index("way")
        times = own["ms_per_face"]
        axes.plot([times.min(), times.max()], [height] * 2, color="#CCCCCC", lw=0.8, zorder=1)
        for way, time in times.items():
            _, ink, shape = _WAYS[way]
            axes.plot(time, height, marker=shape, color=ink, ms=5, mew=0, ls="none")
        fastest = own["times_released"].drop(_OTHER, errors="ignore").idxmax()
        axes.annotate(
            f"×{_times(own.loc[fastest, 'times_released'])}",
            (own.loc[fastest, "ms_per_face"], height),
            xytext=(0, 5), textcoords="offset points", ha="center", size=7, color=INK,
        )  # fmt: skip
    axes.set(xscale="log", yticks=range(len(parts)), yticklabels=parts)
    axes.set_ylim(len(parts) - 0.5, -0.6)
    axes.xaxis.set_major_formatter(_PLAIN)
    axes.margins(x=0.1)
    axes.grid(axis="x")


def _times(ratio: float) -> str:
    return f"{ratio:,.0f}" if ratio >= 10 else factor(ratio)


def _draw_growth(axes: Axes, rows: pd.DataFrame, size: str, time: str) -> None:
    for (part, way), own in rows.groupby(["part", "way"], sort=False):
        own = own.sort_values(size)
        ink, shape = _PARTS[part]
        axes.plot(
            own[size], own[time], color=ink, ls=_DASHES[way], marker=shape, ms=4, mew=0, lw=1.0
        )
    axes.set(xscale="log", yscale="log")
    axes.yaxis.set_major_formatter(_PLAIN)
    numbers = sorted(rows[size].unique())
    axes.set_xticks(numbers, [f"{number:,}" for number in numbers])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.grid()


def _draw_jobs(axes: Axes, rows: pd.DataFrame) -> None:
    for (part, way), own in rows.groupby(["part", "way"], sort=False):
        own = own.sort_values("jobs")
        ink, shape = _PARTS[part]
        speed = own["ms_per_face"].iloc[0] / own["ms_per_face"]
        axes.plot(own["jobs"], speed, color=ink, ls=_DASHES[way], marker=shape, ms=4, mew=0, lw=1.0)
    if len(rows):
        most = rows["jobs"].max()
        axes.plot([1, most], [1, most], color="#999999", lw=0.6, zorder=1)
        axes.annotate("ideal ", (most, most), ha="right", va="bottom", size=7, color=INK)
    else:
        axes.text(0.5, 0.5, "one core only", transform=axes.transAxes, ha="center", color=INK)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid()


def _legends(figure: Figure, rows: pd.DataFrame) -> None:
    shown = [way for way in _WAYS if way in set(rows.loc[rows["comparison"] == "parts", "way"])]
    ways = [
        Line2D([], [], color=_WAYS[way][1], marker=_WAYS[way][2], ms=5, mew=0, ls="none",
               label=_WAYS[way][0])
        for way in shown
        if way != "batched" or "ours" not in shown
    ]  # fmt: skip
    figure.axes[0].legend(
        handles=ways, loc="upper center", bbox_to_anchor=(0.45, -0.17), ncols=2, columnspacing=1
    )
    parts = [
        Line2D([], [], color=ink, marker=shape, ms=4, mew=0, lw=1.0, label=part)
        for part, (ink, shape) in _PARTS.items()
    ]
    dashes = [
        Line2D([], [], color=INK, ls=_DASHES[way], lw=1.0, label=label)
        for way, label in (
            ("released", "released way"),
            ("sklearn", "scikit-learn's solver"),
            ("ours", "ours, batched solver"),
        )
    ]
    figure.legend(handles=parts + dashes, loc="outside lower center", ncols=4)
