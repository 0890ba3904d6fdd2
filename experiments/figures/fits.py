"""Figure of the face model fitted to photos, and its distance from the ground truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from deepmds_keras.alignment import align
from experiments.figures.style import INK, TRUTH_COLOUR, styled
from experiments.figures.wireframe import bare, draw_wireframe, front_view, side_view

if TYPE_CHECKING:
    from deepmds_keras.landmarks import LandmarkScheme

_FIT_COLOUR, _DETECTED_COLOUR = "#0072B2", "#FFD000"
_COLOURS = (_FIT_COLOUR, "#8C6D31")
_PHOTO_INCHES, _PHOTO_ROW, _SHAPE_ROW, _HISTOGRAM_INCHES, _HEAD = 1.35, 1.62, 0.95, 1.75, 0.36


@dataclass(frozen=True, eq=False)
class FittedPhoto:
    """A photo and what was found in it.

    Attributes:
        image: `(H, W, 3)` uint8.
        detected: `(D, 2)` landmarks of the detector, pixels, x right and y down.
        projected: `(L, 2)` landmarks of the fitted model, likewise.
        fitted: `(L, 3)` the same in space, millimetres.
        truth: `(L, 3)` the true ones, or None.
    """

    image: np.ndarray
    detected: np.ndarray
    projected: np.ndarray
    fitted: np.ndarray
    truth: np.ndarray | None


@styled
def fits(
    photos: Sequence[FittedPhoto],
    scheme: LandmarkScheme,
    distances: Mapping[str, np.ndarray] | None,
) -> Figure:
    """Photos with detected and fitted landmarks; below, the shapes; last, how far off they are.

    Args:
        photos: Some.
        scheme: Landmark scheme, for its polylines.
        distances: What of to the root mean square distance of each test face's landmarks from the
            truth, millimetres; None where the truth is not known.
    """
    n = len(photos)
    below = 0 if distances is None else _HISTOGRAM_INCHES
    height = _HEAD + _PHOTO_ROW + _SHAPE_ROW + below
    figure = Figure(figsize=(max(n * _PHOTO_INCHES, 4.2), height))
    wide = figure.get_figwidth() / n
    for k, photo in enumerate(photos):
        high, across = photo.image.shape[:2]
        axes = _panel(figure, k * wide, below + _SHAPE_ROW, wide, _PHOTO_ROW - 0.05)
        axes.imshow(photo.image, extent=(0, across, high, 0))
        draw_wireframe(
            axes, photo.projected, scheme.polylines, colour=_FIT_COLOUR, linewidth=0.7, dot_area=1
        )
        axes.scatter(*photo.detected.T, s=1.5, c=_DETECTED_COLOUR, linewidths=0, zorder=3)
        bare(axes, (0, across, high, 0))

        axes = _panel(figure, k * wide, below, wide, _SHAPE_ROW)
        fitted = photo.fitted
        if photo.truth is not None:
            fitted = align(photo.fitted, photo.truth)
        shift = 0.75 * np.ptp(fitted[:, 0])
        for shape, colour in ((photo.truth, TRUTH_COLOUR), (fitted, _FIT_COLOUR)):
            if shape is None:
                continue
            middle = (fitted.max(0) + fitted.min(0)) / 2
            front, side = front_view(shape - middle), side_view(shape - middle)
            draw_wireframe(axes, front - (shift / 2, 0), scheme.polylines, colour=colour)
            draw_wireframe(axes, side + (shift, 0), scheme.polylines, colour=colour)
        reach = 0.62 * np.ptp(fitted[:, 1])
        bare(axes, (-1.4 * shift, 1.5 * shift, -reach, reach))
    figure.text(
        0.02, 1 - 0.08 / height, "Photos: landmarks detected (yellow), model fitted (blue).\n"
        "Below: fitted and, in grey, true shape, from the front and the side.",
        va="top", size=6.5, color=INK,
    )  # fmt: skip
    if distances is not None:
        axes = _panel(figure, 0.55, 0.42, figure.get_figwidth() - 0.7, below - 0.5)
        longest = np.quantile(np.concatenate([*distances.values()]), 0.995)
        bins = np.linspace(0, longest, 50)
        for (name, own), colour in zip(distances.items(), _COLOURS, strict=True):
            label = f"{name}: median {np.median(own):.1f} mm"
            axes.hist(own, bins, histtype="step", color=colour, label=label, linewidth=1)
        axes.set(
            xlabel="root mean square distance from the true landmarks, mm", ylabel="test faces"
        )
        axes.set_ylim(0, 1.4 * axes.get_ylim()[1])
        axes.legend(loc="upper right")
    return figure


def _panel(figure: Figure, left: float, bottom: float, width: float, height: float):
    """Axes at a place in inches."""
    across, high = figure.get_size_inches()
    return figure.add_axes((left / across, bottom / high, width / across, height / high))
