"""Figures of the audit: errors along what is varied, spectra, times, bias and mini-batches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator

from deepmds_keras.io.errors import InputError
from experiments.figures.style import INK, colour, marker, styled
from experiments.methods import title
from experiments.scoring.numbers import minus

# What is varied, as on the axis.
_SWEEPS = {
    "yaw": "Yaw (degrees)",
    "pitch": "Pitch (degrees)",
    "roll": "Roll (degrees)",
    "field_of_view": "Field of view (degrees)",
    "noise_percent": "Noise (% of interocular distance)",
    "missing_percent": "Missing landmarks (%)",
    "training_faces": "Training faces",
}
_LOGARITHMIC = ("training_faces",)
# What the audit makes of a method: title, colour and marker.
_ALTERED = {"without_autoencoder": ("Deep-MDS without autoencoder", "#A6761D", "P")}
_TRAINED_COLOUR = "#EFEFEF"
_SPECTRA = {
    "true 3D distances": ("#777777", "s"),
    "learnt dissimilarities": ("#D55E00", "o"),
    "frontal view": ("#0072B2", "^"),
}
_SMALLEST_SHARE = 1e-4  # what lies below is rounding, or as good as nothing
_PARTS = {
    "embedding": ("#D55E00", "o"),
    "classical start": ("#0072B2", "^"),
    "one SMACOF iteration": ("#009E73", "D"),
    "dissimilarity net": ("#7B1FA2", "s"),
}
_BATCHES = {"same_face": ("pairs of one face", "#D55E00"),
            "shuffled": ("pairs of different faces", "#0072B2")}  # fmt: skip
_SCHEDULES = {"": "Constant rate", "_stable": "Decayed rate"}
_LOSS_UNIT, _FIRST_EPOCH = 1e-4, 3
_MODES = {"train": "Training mode", "inference": "Inference mode"}
_PLAIN = FuncFormatter(lambda value, _: minus(f"{value:g}"))


@styled
def error_curves(
    curves: pd.DataFrame, sweeps: Sequence[str], ranges: Mapping[str, tuple[float, float]]
) -> Figure:
    """Error against what is varied, with 95 % confidence intervals of the mean.

    Args:
        curves: A row per point: `sweep`, `value`, `method` (id), `mse` in squared normalised units
            and its standard error `sem`.
        sweeps: Which of them, a panel each.
        ranges: Sweep to the values of the training views, which are shaded.

    Raises:
        InputError: No such sweep.
    """
    unknown = [sweep for sweep in sweeps if sweep not in _SWEEPS]
    if unknown:
        raise InputError(f"sweeps must be of {', '.join(_SWEEPS)}. Received {', '.join(unknown)}.")
    shown = curves[curves["sweep"].isin(sweeps)]
    methods = list(dict.fromkeys(shown["method"]))
    n_columns = 2 if len(sweeps) == 4 else len(sweeps)
    n_rows = len(sweeps) // n_columns
    figure = Figure(figsize=(7.2, 0.7 + 2.3 * n_rows), layout="constrained")
    panels = figure.subplots(n_rows, n_columns, sharey=True, squeeze=False)
    for axes, sweep in zip(panels.flat, sweeps, strict=True):
        if sweep in ranges:
            # As wide as a line where it is one value.
            axes.axvspan(*ranges[sweep], facecolor=_TRAINED_COLOUR, edgecolor=_TRAINED_COLOUR, lw=2)
        for method in methods:
            rows = shown[(shown["sweep"] == sweep) & (shown["method"] == method)]
            _draw_curve(axes, rows.sort_values("value"), method)
        axes.set(yscale="log", xlabel=_SWEEPS[sweep])
        if sweep in _LOGARITHMIC:
            values = sorted(shown.loc[shown["sweep"] == sweep, "value"].unique())
            axes.set_xscale("log")
            axes.set_xticks(values, [f"{value:,.0f}" for value in values])
            axes.xaxis.set_minor_locator(NullLocator())
        else:
            axes.xaxis.set_major_formatter(_PLAIN)
        axes.margins(x=0.02)
        axes.grid(axis="y")
    for axes in panels[:, 0]:
        axes.set_ylabel("MSE of a face\n(squared normalised units)")
    handles = [
        Line2D([], [], color=look[1], marker=look[2], ms=4, mew=0, lw=0.9, label=look[0])
        for look in map(_look, methods)
    ]
    if any(sweep in ranges for sweep in sweeps):
        handles.append(Patch(facecolor=_TRAINED_COLOUR, label="training views"))
    figure.legend(handles=handles, loc="outside lower center", ncols=4, columnspacing=1.2)
    return figure


@styled
def spectra(spectra: Mapping[str, Sequence[float]]) -> Figure:
    """Shares of the largest eigenvalues; negative ones are hollow.

    Args:
        spectra: Keys of `_SPECTRA` to the shares, of which those below a ten-thousandth are drawn
            at the foot.
    """
    figure = Figure(figsize=(7.2, 2.7), layout="constrained")
    axes = figure.subplots()
    offsets = np.linspace(-0.2, 0.2, len(spectra)) if len(spectra) > 1 else [0.0]
    for offset, (name, shares) in zip(offsets, spectra.items(), strict=True):
        ink, shape = _SPECTRA[name]
        places = np.arange(1, len(shares) + 1) + offset
        heights = np.maximum(np.abs(shares), _SMALLEST_SHARE)
        axes.vlines(places, _SMALLEST_SHARE, heights, color=ink, lw=0.9)
        for place, height, share in zip(places, heights, shares, strict=True):
            # Neither sign nor size of what is at the foot means anything.
            face = ink if share > 0 or height == _SMALLEST_SHARE else "white"
            axes.plot(place, height, marker=shape, ms=5, mec=ink, mfc=face, mew=0.9, clip_on=False)
    axes.set(yscale="log", xlabel="Eigenvalue, from the largest in absolute value")
    axes.set_ylabel("Share of the sum\nof absolute values")
    axes.set_ylim(_SMALLEST_SHARE, 1)
    axes.set_yticks(
        [1, 1e-1, 1e-2, 1e-3, _SMALLEST_SHARE], ["100 %", "10 %", "1 %", "0.1 %", "< 0.01 %"]
    )
    axes.yaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(axis="y")
    handles = [
        Line2D([], [], color=ink, marker=shape, ms=5, mew=0.9, lw=0.9, label=name)
        for name, (ink, shape) in _SPECTRA.items()
        if name in spectra
    ]
    hollow = {"color": INK, "mfc": "white", "marker": "o", "ms": 5, "mew": 0.9, "ls": "none"}
    handles.append(Line2D([], [], label="negative", **hollow))
    axes.legend(handles=handles, loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


@styled
def timings(rows: pd.DataFrame) -> Figure:
    """Time of a face against the number of landmarks, with n³ to compare.

    Args:
        rows: `landmarks`, `part` (key of `_PARTS`) and `ms`.
    """
    figure = Figure(figsize=(7.2, 3.0), layout="constrained")
    axes = figure.subplots()
    for part, (ink, shape) in _PARTS.items():
        own = rows[rows["part"] == part].sort_values("landmarks")
        style = {"color": ink, "marker": shape, "ms": 4.5, "mew": 0, "lw": 1.0}
        axes.plot(own["landmarks"], own["ms"], label=part, **style)
    numbers = np.array(sorted(rows["landmarks"].unique()))
    cube = rows["ms"].max() * (numbers / numbers[-1]) ** 3
    axes.plot(numbers, cube, color="#999999", lw=0.6, ls=(0, (4, 2)), label="n³", zorder=1)
    axes.set(xscale="log", yscale="log", xlabel="Landmarks", ylabel="Time of a face (ms)")
    axes.set_xticks(numbers, [str(number) for number in numbers])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(_PLAIN)
    axes.grid()
    axes.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


@styled
def bias(methods: Mapping[str, Mapping[str, float]]) -> Figure:
    """Share of a face's distance from the mean shape that each method's answer has.

    Args:
        methods: Id to `slope` of the answer's offset from the mean shape on the true one, its
            standard error `slope_se`, and their `correlation`.
    """
    figure = Figure(figsize=(7.2, 1.1 + 0.22 * len(methods)), layout="constrained")
    slopes, correlations = figure.subplots(1, 2, sharey=True, width_ratios=(1.7, 1))
    for row, (method, own) in enumerate(methods.items()):
        _, ink, shape = _look(method)
        style = {"color": ink, "marker": shape, "ms": 5, "mew": 0}
        slopes.errorbar(own["slope"], row, xerr=1.96 * own["slope_se"], elinewidth=0.9, **style)
        correlations.plot(own["correlation"], row, **style)
    for value, label in ((0, "always the\nmean shape"), (1, "unbiased")):
        slopes.axvline(value, color=INK, lw=0.7, ls=(0, (4, 2)), zorder=1)
        slopes.annotate(
            label, (value, 1), xycoords=("data", "axes fraction"), xytext=(0, 2), size=7,
            textcoords="offset points", ha="center", va="bottom", color=INK,
        )  # fmt: skip
    slopes.set_xlabel("Slope on the true offset from the mean shape (no unit)")
    slopes.margins(x=0.08)
    lowest = min(0, *(own["correlation"] for own in methods.values()))
    correlations.set(xlabel="Correlation (no unit)", xlim=(lowest - 0.05, 1.05))
    correlations.axvline(0, color=INK, lw=0.7, ls=(0, (4, 2)), zorder=1)
    slopes.set_yticks(range(len(methods)), [_look(method)[0] for method in methods])
    slopes.set_ylim(len(methods) - 0.5, -0.5)
    for axes in (slopes, correlations):
        axes.tick_params(axis="y", length=0)
        axes.xaxis.set_major_formatter(_PLAIN)
        axes.grid(axis="x")
    return figure


@styled
def mini_batches(losses: pd.DataFrame) -> Figure:
    """Loss of the dissimilarity net against training time, by what its mini-batches hold.

    Args:
        losses: A row an epoch: `variant` (key of `_BATCHES`, with `_stable` after it for a decayed
            learning rate), `seed`, `epoch`, and mean squared errors in squared normalised units,
            `train` as the optimiser sees them and `inference` of the net after the epoch.
    """
    variants = set(losses["variant"])
    schedules = [suffix for suffix in _SCHEDULES if variants & {f"{b}{suffix}" for b in _BATCHES}]
    figure = Figure(figsize=(7.2, 0.6 + 2.1 * len(schedules)), layout="constrained")
    panels = figure.subplots(len(schedules), 2, sharex=True, sharey=True, squeeze=False)
    for (left, right), suffix in zip(panels, schedules, strict=True):
        for batches, (_, ink) in _BATCHES.items():
            own = losses[losses["variant"] == f"{batches}{suffix}"]
            for _, run in own.sort_values("epoch").groupby("seed"):
                for axes, mode in ((left, "train"), (right, "inference")):
                    axes.plot(run["epoch"], run[mode] / _LOSS_UNIT, color=ink, lw=0.7, alpha=0.85)
        left.set_ylabel(
            f"{_SCHEDULES[suffix]}: mean squared error\n($10^{{-4}}$ squared normalised units)"
        )
    for axes, name in zip(panels[0], _MODES.values(), strict=True):
        axes.set_title(name)
    # In the first epochs all fall alike, and so far that no difference would be seen after them.
    first = min(_FIRST_EPOCH, losses["epoch"].max())
    shown = losses.loc[losses["epoch"] >= first, ["train", "inference"]].to_numpy()
    for axes in panels.flat:
        axes.set(ylim=(0.95 * shown.min() / _LOSS_UNIT, 1.05 * shown.max() / _LOSS_UNIT))
        axes.set_xlim(first - 0.5, losses["epoch"].max() + 0.5)
        axes.grid(axis="y")
    for axes in panels[-1]:
        axes.set_xlabel("Training time (epochs)")
        axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    figure.legend(
        handles=[Line2D([], [], color=ink, label=label) for label, ink in _BATCHES.values()],
        loc="outside lower center",
        ncols=2,
    )
    return figure


def _draw_curve(axes: Axes, rows: pd.DataFrame, method: str) -> None:
    _, ink, shape = _look(method)
    half = 1.96 * rows["sem"]
    axes.fill_between(
        rows["value"], rows["mse"] - half, rows["mse"] + half, color=ink, alpha=0.18, lw=0
    )
    axes.plot(rows["value"], rows["mse"], color=ink, marker=shape, ms=3.5, mew=0, lw=0.9)


def _look(method: str) -> tuple[str, str, str]:
    """Title, colour and marker."""
    return _ALTERED.get(method) or (title(method), colour(method), marker(method))
