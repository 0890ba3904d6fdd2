"""Figure of the transfer: errors by noise, a panel for each face model tested on."""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure

from experiments.face_models import TITLES
from experiments.figures.style import colour, marker, styled
from experiments.methods import title

_UNIT = 1e-5


@styled
def across_models(table: pd.DataFrame) -> Figure:
    """Mean squared error against the noise of the landmarks, a line a method.

    Args:
        table: `trained` and `tested` (face models), `noise_mm`, `method` (id), `mse` and its
            standard error `sem`, in squared normalised units.
    """
    tested = list(dict.fromkeys(table["tested"]))
    figure = Figure(figsize=(1.2 + 2.9 * len(tested), 2.9), layout="constrained")
    panels = figure.subplots(1, len(tested), sharey=True, squeeze=False)[0]
    for axes, model in zip(panels, tested, strict=True):
        rows = table[table["tested"] == model]
        for method, own in rows.groupby("method", sort=False):
            axes.errorbar(
                own["noise_mm"], own["mse"] / _UNIT, yerr=own["sem"] / _UNIT, label=title(method),
                color=colour(method), marker=marker(method), ms=4, mew=0, lw=1.0,
            )  # fmt: skip
        same = model == rows["trained"].iloc[0]
        axes.set(title=f"Tested on {'the same model' if same else TITLES[model]}", yscale="log")
        axes.set_xlabel("Noise of each coordinate (mm)")
        axes.set_xticks(sorted(rows["noise_mm"].unique()))
        axes.grid(axis="y")
    panels[0].set_ylabel("MSE ($10^{-5}$ squared normalised units)")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right center")
    figure.suptitle(f"Trained on {TITLES[table['trained'].iloc[0]]}", size=8)
    return figure
