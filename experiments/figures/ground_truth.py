"""The ground truth taken from scans or photos, and its distance from the true landmarks."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from deepmds_keras.geometry.alignment import align
from deepmds_keras.landmarks import LandmarkScheme
from experiments.figures.style import DETECTED_COLOUR, INK, TRUTH_COLOUR, look, styled
from experiments.figures.wireframe import (
    bare,
    draw_error_map,
    draw_photo,
    draw_wireframe,
    front_view,
    side_view,
)
from experiments.methods import title

_FIT_COLOUR = "#0072B2"
# Landmarks of a scan → legend entry and look; those drawn beneath are larger and hollow.
_MARKS = {
    "detected": ("detected", {"color": DETECTED_COLOUR, "marker": "o", "ms": 1.6, "mew": 0}),
    "truth": ("true landmark",
              {"color": "#009E73", "marker": "o", "ms": 4, "mew": 0.8, "mfc": "none"}),
    "landmarks": ("nearest point of the scan: the truth of the table",
                  {"color": "#D55E00", "marker": "o", "ms": 2.2, "mew": 0}),
    "fitted": ("fitted model", {"color": _FIT_COLOUR, "marker": "x", "ms": 3, "mew": 0.6}),
}  # fmt: skip
_PAD_MM = 14.0
_CLOUD = 2000  # points of a scan that are drawn


@styled
def ground_truth(
    scans: Mapping[str, np.ndarray],
    shown: np.ndarray,
    images: np.ndarray,
    detected: np.ndarray,
    scheme: LandmarkScheme,
) -> Figure:
    """Photo, scan and landmarks of some scans; below, the error of the truth by landmark.

    Args:
        scans: Table of `datasets.scans`: `fitted`, `landmarks` and perhaps `truth`, `(n, L, 3)`
            millimetres, and `example_points`, `(k, m, 3)`, in one frame. Without the truth there
            are no errors.
        shown: `(k,)` faces to draw, one per column.
        images: `(k, S, S, 3)` uint8 photos around their landmarks.
        detected: `(k, L, 2)` pixels in these.
    """
    # Fixed positions: a constrained layout differs in the last digit from run to run.
    marks = {name: mark for name, mark in _MARKS.items() if name in {"detected", *scans}}
    figure = Figure(figsize=(7.2, 8.0 if "truth" in scans else 5.8))
    low = 0.29 if "truth" in scans else 0.01
    grid = {"left": 0.01, "right": 0.99, "bottom": low, "top": 0.95, "wspace": 0.02, "hspace": 0.02}
    panels = figure.subplots(3, len(shown), squeeze=False, gridspec_kw=grid)
    for number, (photo, *views) in enumerate(panels.T):
        draw_photo(photo, images[number])
        photo.plot(*detected[number].T, ls="none", **marks["detected"][1])
        landmark_sets = {name: scans[name][shown[number]] for name in marks if name != "detected"}
        for axes, view in zip(views, (front_view, side_view), strict=True):
            _draw_scan(axes, scans["example_points"][number], landmark_sets, view)
    handles = [Line2D([], [], ls="none", label=label, **look) for label, look in marks.values()]
    figure.legend(handles=handles, loc="upper center", ncols=4, handletextpad=0.1, markerscale=1.5)
    if "truth" in scans:
        _draw_errors(figure, scheme, scans["landmarks"], scans["truth"])
    return figure


def _draw_scan(
    axes: Axes,
    points: np.ndarray,
    landmark_sets: Mapping[str, np.ndarray],
    view: Callable[[np.ndarray], np.ndarray],
) -> None:
    inside = view(np.concatenate([*landmark_sets.values()]))
    low, high = inside.min(0) - _PAD_MM, inside.max(0) + _PAD_MM
    bare(axes, (low[0], high[0], low[1], high[1]))
    cloud = view(points)
    cloud = cloud[((cloud > low) & (cloud < high)).all(1)][:_CLOUD]
    axes.plot(*cloud.T, ".", color=TRUTH_COLOUR, ms=1, mew=0, zorder=1)
    for name, landmarks in landmark_sets.items():
        axes.plot(*view(landmarks).T, ls="none", **_MARKS[name][1])


def _draw_errors(
    figure: Figure, scheme: LandmarkScheme, landmarks: np.ndarray, truth: np.ndarray
) -> None:
    """The face coloured by median distance, next to the distances of all landmarks.

    They are those that the table sees, which aligns each face: without the pose of a scan.
    """
    landmarks = align(landmarks, truth, scaling=False, reflection=False)
    distance = np.linalg.norm(landmarks - truth, axis=2)
    median = np.median(distance, axis=0)
    colours = ScalarMappable(Normalize(0, median.max()), "viridis_r")
    face = figure.add_axes((0.02, 0.02, 0.3, 0.24))
    draw_error_map(face, truth.mean(0), scheme.polylines, median, colours)
    bar = figure.colorbar(colours, cax=figure.add_axes((0.34, 0.05, 0.012, 0.18)))
    bar.set_label("Median distance\nto the truth (mm)")
    axes = figure.add_axes((0.55, 0.06, 0.43, 0.19))
    for values, label, ink in (
        (distance.ravel(), "landmarks", _MARKS["landmarks"][1]["color"]),
        (distance.mean(1), "means of a face", INK),
    ):
        share = np.linspace(0, 1, 501)
        axes.plot(np.quantile(values, share), 100 * share, color=ink, label=label)
    axes.set(
        xlabel="Distance from the true landmark, once aligned (mm)",
        ylabel="Share within (%)",
        xlim=(0, np.quantile(distance, 0.995)),
        ylim=(0, 100),
    )
    axes.grid()
    axes.legend(loc="lower right")


@styled
def fits(
    images: Sequence[np.ndarray],
    detected: np.ndarray,
    fitted: np.ndarray,
    scheme: LandmarkScheme,
    distances: Mapping[str, np.ndarray],
) -> Figure:
    """Photos with detected and fitted landmarks, and a histogram of distances from the truth.

    Args:
        images: Photos, `(H, W, 3)` uint8, a column each.
        detected: `(n, D, 2)` landmarks of the detector, pixels.
        fitted: `(n, L, 2)` landmarks of the fitted model, pixels.
        distances: Id of the fit or of another method → the root mean square distance of each test
            face's landmarks from the truth, millimetres; empty if that is unknown.
    """
    below = 1.75 if distances else 0
    height = 2.1 + below
    figure = Figure(figsize=(max(1.35 * len(images), 4.2), height))
    panels = figure.subplots(1, len(images), squeeze=False)[0]
    figure.subplots_adjust(0, below / height, 1, 1 - 0.25 / height, wspace=0.05)
    for axes, image, model, points in zip(panels, images, fitted, detected, strict=True):
        draw_photo(axes, image)
        blue = {"colour": _FIT_COLOUR, "linewidth": 0.7, "dot_area": 1}
        draw_wireframe(axes, model, scheme.polylines, **blue)
        axes.scatter(*points.T, s=1.5, c=DETECTED_COLOUR, linewidths=0, zorder=3)
    legend = "Photos: landmarks detected (yellow), model fitted (blue)."
    figure.text(0.02, 1 - 0.08 / height, legend, va="top", size=6.5, color=INK)
    if distances:
        axes = figure.add_axes((0.13, 0.42 / height, 0.84, (below - 0.5) / height))
        bins = np.linspace(0, np.quantile(np.concatenate([*distances.values()]), 0.995), 50)
        for method, values in distances.items():
            label = f"{title(method)}: median {np.median(values):.1f} mm"
            axes.hist(values, bins, histtype="step", color=look(method).colour, label=label)
        axes.set_xlabel("Root mean square distance from the true landmarks (mm)")
        axes.set_ylabel("Test faces")
        axes.margins(y=0.4)
        axes.legend(loc="upper right")
    return figure
