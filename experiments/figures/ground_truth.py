"""Figure of the ground truth found on scans, and its distance from the true landmarks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiments.figures.style import INK, TRUTH_COLOUR, styled
from experiments.figures.wireframe import bare, draw_wireframe, front_view, side_view

if TYPE_CHECKING:
    from deepmds_keras.landmarks import LandmarkScheme

_FITTED, _FOUND, _TRUE, _DETECTED = "#0072B2", "#D55E00", "#009E73", "#FFD000"
_PAD_MM = 14.0
_CLOUD = 2000  # points of a scan that are drawn


@dataclass(frozen=True, eq=False)
class Example:
    """One scan of the test set; 3D points in the frame of the face model, millimetres.

    Attributes:
        image: `(S, S, 3)` uint8 photo about the landmarks.
        detected: `(L, 2)` pixels in it.
        points: `(n, 3)` some points of the scan.
        fitted: `(L, 3)` landmarks of the fitted model.
        found: `(L, 3)` the points of the scan that are taken for the truth.
        truth: `(L, 3)` true landmarks, or None.
    """

    image: np.ndarray
    detected: np.ndarray
    points: np.ndarray
    fitted: np.ndarray
    found: np.ndarray
    truth: np.ndarray | None


@styled
def ground_truth(
    examples: Sequence[Example],
    scheme: LandmarkScheme,
    found: np.ndarray,
    truth: np.ndarray | None,
) -> Figure:
    """Photo, scan and landmarks of some scans; below, the error of the truth by landmark.

    Args:
        examples: Drawn a column each.
        scheme: Landmark scheme, for its polylines.
        found: `(n, L, 3)` landmarks found on the scans, millimetres.
        truth: `(n, L, 3)` true ones, or None, which leaves the errors out.
    """
    # Places are given: a layout that is solved for differs in the last digit from run to run.
    figure = Figure(figsize=(7.2, 5.8 if truth is None else 8.0))
    low = 0.01 if truth is None else 0.29
    grid = {"left": 0.01, "right": 0.99, "bottom": low, "top": 0.95, "wspace": 0.02, "hspace": 0.02}
    panels = figure.subplots(3, len(examples), squeeze=False, gridspec_kw=grid)
    if truth is not None:
        _errors(figure, scheme, np.linalg.norm(found - truth, axis=2), truth.mean(0))
    for column, example in zip(panels.T, examples, strict=True):
        _photo(column[0], example)
        _scan(column[1], example, front_view)
        _scan(column[2], example, side_view)
    marks = {
        "detected": _DETECTED,
        "fitted model": _FITTED,
        "nearest point of the scan: the truth of the table": _FOUND,
    }
    if truth is not None:
        marks["true landmark"] = _TRUE
    handles = [
        Line2D([], [], color=ink, marker="o", ls="none", ms=3.5, mew=0, label=label)
        for label, ink in marks.items()
    ]
    figure.legend(handles=handles, loc="upper center", ncols=4, handletextpad=0.1)
    return figure


def _photo(axes: Axes, example: Example) -> None:
    size = len(example.image)
    axes.imshow(example.image, extent=(0, size, size, 0), interpolation="none")
    axes.plot(*example.detected.T, "o", color=_DETECTED, ms=1.6, mew=0)
    axes.set(xlim=(0, size), ylim=(size, 0))
    axes.set_axis_off()


def _scan(axes: Axes, example: Example, see) -> None:
    marks = [example.fitted, example.found]
    marks += [] if example.truth is None else [example.truth]
    inside = np.concatenate([see(points) for points in marks])
    low, high = inside.min(0) - _PAD_MM, inside.max(0) + _PAD_MM
    bare(axes, (low[0], high[0], low[1], high[1]))
    cloud = see(example.points)
    cloud = cloud[((cloud > low) & (cloud < high)).all(1)][:_CLOUD]
    axes.plot(*cloud.T, ".", color=TRUTH_COLOUR, ms=1, mew=0, zorder=1)
    for points, ink in zip(marks, (_FITTED, _FOUND, _TRUE), strict=False):
        axes.plot(*see(points).T, "o", color=ink, ms=2, mew=0, zorder=2)


def _errors(figure: Figure, scheme: LandmarkScheme, distance: np.ndarray, mean: np.ndarray) -> None:
    """The face coloured by the median distance, beside the distances of all landmarks."""
    axes = figure.add_axes((0.02, 0.02, 0.3, 0.24))
    shares = figure.add_axes((0.55, 0.06, 0.43, 0.19))
    points = front_view(mean)
    low, high = points.min(0) - 4, points.max(0) + 4
    bare(axes, (low[0], high[0], low[1], high[1]))
    draw_wireframe(axes, points, scheme.polylines, colour=TRUTH_COLOUR, dot_area=0)
    median = np.median(distance, axis=0)
    colours = ScalarMappable(Normalize(0, median.max()), "viridis_r")
    axes.scatter(
        *points.T, s=16, c=colours.to_rgba(median), edgecolors=INK, linewidths=0.3, zorder=3
    )
    bar = figure.colorbar(colours, cax=figure.add_axes((0.34, 0.05, 0.012, 0.18)))
    bar.set_label("median distance\nto the truth (mm)")
    for values, label, ink in (
        (distance.ravel(), "landmarks", _FOUND),
        (distance.mean(1), "means of a face", INK),
    ):
        share = np.arange(1, values.size + 1) / values.size
        step = max(values.size // 2000, 1)
        shares.plot(np.sort(values)[::step], 100 * share[::step], color=ink, label=label)
    shares.set(
        xlabel="distance of the found landmark from the true one (mm)",
        ylabel="share within (%)",
        xlim=(0, np.quantile(distance, 0.995)),
        ylim=(0, 100),
    )
    shares.grid()
    shares.legend(loc="lower right")
