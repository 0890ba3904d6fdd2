"""Losses over training: both networks' learning curves, and the lag of batch normalisation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from experiments.figures.style import INK, colour, styled
from experiments.methods import title

_NETWORKS = {"autoencoder": "Autoencoder", "dissimilarity_net": "Dissimilarity net"}
# Key of a record to line style and legend entry.
_MODES = {
    "train": ((0, (3, 1.5)), "training faces, training mode"),
    "inference": ("-", "training faces, inference mode"),
    "test": ((0, (1, 1.2)), "test faces, inference mode"),
}
_SCHEDULES = {"constant": "Constant learning rate", "cosine": "Cosine schedule"}


@styled
def learning_curves(
    histories: Mapping[str, Mapping[str, Mapping[str, Sequence[float]]]],
    mobileface: Mapping[str, Sequence[float]] | None = None,
    ringnet: Mapping[str, Sequence[float]] | None = None,
) -> Figure:
    """Loss against training time, the autoencoder beside the dissimilarity net, and others.

    Args:
        histories: Method id to `"autoencoder"` and `"dissimilarity_net"` (`DeepMDS.history_`),
            each a record with one mean squared error an epoch, in squared normalised units:
            `"train"` as seen by the optimiser, `"inference"` of the network after the epoch,
            `"test"` on test faces. What a record lacks is not drawn.
        mobileface: Such a record in square millimetres; None leaves its panel out.
        ringnet: Such a record of the sum of RingNet's losses; likewise.
    """
    others = {
        method: (losses, unit)
        for method, losses, unit in (
            ("mobileface", mobileface, "Mean squared error of the mesh (mm²)"),
            ("ringnet", ringnet, "Sum of the losses (no unit)"),
        )
        if losses is not None
    }
    figure = Figure(figsize=(7.2, 3.1), layout="constrained")
    panels = figure.subplots(1, 2 + len(others))
    shown = set()
    for axes, (network, name) in zip(panels[:2], _NETWORKS.items(), strict=True):
        # Methods may share a network: the one named first is drawn last, on top.
        for method, networks in reversed(histories.items()):
            for mode, losses in networks.get(network, {}).items():
                shown.add(mode)
                axes.plot(
                    _epochs(losses), losses, color=colour(method), linestyle=_MODES[mode][0], lw=1.1
                )
        axes.set(yscale="log", title=name)
        _time_axis(axes)
    panels[0].set_ylabel("Mean squared error\n(squared normalised units)")
    methods = [*histories, *others]
    for axes, (method, (record, unit)) in zip(panels[2:], others.items(), strict=True):
        for mode, losses in record.items():
            line = {"color": colour(method), "linestyle": _MODES[mode][0], "lw": 1.1}
            axes.plot(_epochs(losses), losses, **line)
        axes.set(yscale="log", title=title(method), ylabel=unit)
        _time_axis(axes)
    figure.legend(
        handles=[Line2D([], [], color=colour(m), label=title(m)) for m in methods],
        loc="outside upper center",
        ncols=4,
    )
    figure.legend(
        handles=[
            Line2D([], [], color=INK, linestyle=dashes, label=label)
            for mode, (dashes, label) in _MODES.items()
            if mode in shown
        ],
        loc="outside lower center",
        ncols=3,
        handlelength=2.6,
    )
    return figure


@styled
def batchnorm_lag(histories: Mapping[str, Mapping[int, Mapping[str, Sequence[float]]]]) -> Figure:
    """The autoencoder's error by batch statistics and by moving ones, seed by seed.

    If the moving statistics of batch normalisation trail the weights, the network errs more at
    inference than in training, on the same faces. It no longer does once the statistics are
    estimated anew for the weights as they are.

    Args:
        histories: `"constant"` and `"cosine"` to seed to a record with `"train"` and
            `"inference"`, one mean squared error an epoch, and `"reestimated"`, the one after the
            last epoch with statistics of all training faces; in squared normalised units.
    """
    figure = Figure(figsize=(7.2, 2.9), layout="constrained")
    panels = figure.subplots(1, len(histories), sharey=True, squeeze=False)[0]
    looks = {
        "inference": ("#D55E00", "inference mode (moving statistics)"),
        "train": ("#777777", "training mode (statistics of the mini-batch)"),
    }
    anew = {"color": "#0072B2", "marker": "D", "ms": 4, "mew": 0, "ls": "none", "clip_on": False}
    for axes, (schedule, runs) in zip(panels, histories.items(), strict=True):
        for record in runs.values():
            for mode, (ink, _) in looks.items():
                losses = record[mode]
                axes.plot(_epochs(losses), np.sqrt(losses), color=ink, lw=0.8, alpha=0.8)
            axes.plot(len(losses), np.sqrt(record["reestimated"]), **anew)
        axes.set(yscale="log", title=f"{_SCHEDULES[schedule]} ({len(runs)} seeds)")
        _time_axis(axes)
    panels[0].set_ylabel("R.m.s. error of the frontal view\n(normalised units)")
    figure.legend(
        handles=[
            *(Line2D([], [], color=ink, label=label) for ink, label in looks.values()),
            Line2D([], [], **anew, label="statistics estimated anew, same weights"),
        ],
        loc="outside lower center",
        ncols=3,
    )
    return figure


def _epochs(losses: Sequence[float]) -> np.ndarray:
    return np.arange(1, len(losses) + 1)


def _time_axis(axes: Axes) -> None:
    axes.set_xlabel("Training time (epochs)")
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    axes.margins(x=0.02)
    axes.grid(axis="y")
