"""Losses over training: both networks' learning curves, and the lag of batch normalisation."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from experiments.figures.errors import Panel, error_lines, plain_log_ticks
from experiments.figures.style import INK, Look, look, styled
from experiments.methods import title

FIRST_EPOCH = 3  # earlier losses would hide all later differences
_NETWORKS = {"autoencoder": "Autoencoder", "dissimilarity_net": "Dissimilarity net"}
_IMAGE_LOSSES = {
    "mobileface": "Mean squared error\nof the mesh (mm²)",
    "ringnet": "Sum of the losses (no unit)",
}
# Key of a record to line style and legend entry.
_MODES = {"train": ((0, (3, 1.5)), "training mode"), "inference": ("-", "inference mode")}
_SCHEDULES = {"constant": "Constant learning rate", "cosine": "Cosine schedule"}
_LAG = {
    "inference": Look("inference mode (running statistics)", "#D55E00", ""),
    "train": Look("training mode (statistics of the mini-batch)", "#777777", ""),
    "reestimated": Look("statistics estimated again", "#0072B2", "D", ""),
}


def epochs_from(first: int) -> str:
    """Label of an axis of epochs that leaves out those before one."""
    return f"Training time (epochs),\nfrom epoch {first} on"


@styled
def learning_curves(
    histories: Mapping[str, Mapping[str, Mapping[str, Sequence[float]]]],
    of_images: Mapping[str, Mapping[str, Sequence[float]]] = {},
) -> Figure:
    """Loss on the training faces by epoch, one panel per network, from epoch `FIRST_EPOCH` on.

    Args:
        histories: Method id to `"autoencoder"` and `"dissimilarity_net"` (`DeepMDS.history_`),
            each a record with one mean squared error per epoch, in squared normalised units:
            `"train"` as seen by the optimiser, `"inference"` of the network after the epoch.
            Missing entries are not drawn.
        of_images: Such records of `mobileface`, in square millimetres, or of `ringnet`.
    """
    label = "Mean squared error\n($10^{-4}$ squared normalised units)"
    # Methods may share a network: the one named first is drawn last, on top.
    panels = [
        (name, label, 1e-4, {m: nets.get(network, {}) for m, nets in reversed(histories.items())})
        for network, name in _NETWORKS.items()
    ]
    panels += [(title(m), _IMAGE_LOSSES[m], 1.0, {m: record}) for m, record in of_images.items()]
    figure = Figure(figsize=(7.2, 3.1), layout="constrained")
    for axes, panel in zip(figure.subplots(1, len(panels)), panels, strict=True):
        (name, label, unit, records), first = panel, 1
        for method, record in records.items():
            for mode, losses in record.items():
                style = {"color": look(method).colour, "ls": _MODES[mode][0], "lw": 1.1}
                first = min(FIRST_EPOCH, max(1, len(losses) - 1))
                epochs = range(first, len(losses) + 1)
                axes.plot(epochs, np.divide(losses[first - 1 :], unit), **style)
        axes.set(title=name, ylabel=label, yscale="log", xlabel=epochs_from(first))
        axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
        axes.grid(axis="y")
        plain_log_ticks(axes.yaxis)
    methods = [{"color": look(m).colour, "label": title(m)} for m in [*histories, *of_images]]
    modes = [{"color": INK, "ls": s, "label": f"training faces, {m}"} for s, m in _MODES.values()]
    for looks, place in ((methods, "upper"), (modes, "lower")):
        handles = [Line2D([], [], **look) for look in looks]
        sizes = {"handlelength": 2.6, "columnspacing": 1.2}
        figure.legend(handles=handles, loc=f"outside {place} center", ncols=4, **sizes)
    return figure


def batchnorm_lag(histories: Mapping[str, Mapping[int, Mapping[str, Sequence[float]]]]) -> Figure:
    """The autoencoder's error by batch statistics and by moving ones: mean and range over seeds.

    If the running statistics of batch normalisation lag behind the weights, the error at inference
    exceeds that in training, on the same faces. Re-estimating the statistics for the final weights
    removes the difference.

    Args:
        histories: `"constant"` or `"cosine"` → seed → a record with `"train"` and `"inference"`,
            one mean squared error per epoch, and `"reestimated"`, the one after the last epoch
            with statistics of all training faces; in squared normalised units.
    """
    panels = []
    for schedule, runs in histories.items():
        rows = [
            (mode, epoch, np.sqrt(loss))
            for record in runs.values()
            for mode in ("inference", "train")
            for epoch, loss in enumerate(record[mode], 1)
        ]
        for record in runs.values():
            rows.append(("reestimated", len(record["train"]), np.sqrt(record["reestimated"])))
        errors = pd.DataFrame(rows, columns=["method", "epoch", "error"])
        errors = errors.groupby(["method", "epoch"], sort=False)["error"]
        errors = errors.agg(mean="mean", low="min", high="max").reset_index()
        name = f"{_SCHEDULES[schedule]} ({len(runs)} seeds)"
        panels.append(Panel(errors, "epoch", "Training time (epochs)", name))
    quantity, units = "R.m.s. error of the frontal view", "normalised units"
    return error_lines(panels, quantity, 1, units, looks=_LAG, interval="range over seeds")
