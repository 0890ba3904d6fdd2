"""The qualitative figure: some faces, one per row, and what every method makes of them."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from experiments.figures.style import INK, TRUTH_COLOUR, colour, styled
from experiments.figures.wireframe import bare, draw_wireframe, front_view, side_view
from experiments.methods import title

if TYPE_CHECKING:
    from deepmds_keras.landmarks import LandmarkScheme

_INCHES_PER_UNIT = 1.25  # a face is about 0.65 units wide: 0.8 inch, twelve of them on a page
_GAP = 0.11  # between columns, and between the front and the side view
_ROW_GAP = 0.26  # holds the scores
_HEAD = 0.42  # holds the column titles
_MARGIN = 0.3  # holds the row titles, of up to two lines


@dataclass(frozen=True, eq=False)
class Photos:
    """Photos `(R, S, S, 3)` uint8, and landmarks `(R, L, 2)` in their pixels, y down."""

    images: np.ndarray
    landmarks: np.ndarray


@styled
def qualitative(
    views: np.ndarray,
    frontal: np.ndarray,
    truth: np.ndarray,
    predictions: Mapping[str, np.ndarray],
    scheme: LandmarkScheme,
    row_titles: Sequence[str],
    scores: Mapping[str, np.ndarray],
    photos: Photos | None = None,
) -> Figure:
    """Input view, frontal view, truth and every method's shape from the front and the side.

    Every shape is drawn to one scale; the input views are fitted to the same box. The truth is
    repeated in grey beneath each prediction. Beneath the frontal view it is so after the shift and
    the scaling that fit it best, since a frontal view may be normalised by itself. The lowest error
    of a row is bold. N/A stands for a face that a method did not find.

    Args:
        views: `(R, L, 2)`, one face a row.
        frontal: `(R, L, 2)`, the autoencoder's output for `views`.
        truth: `(R, L, 3)`, normalised.
        predictions: Method id to `(R, L, 3)`, aligned to `truth`; NaN where there is none.
        scheme: Landmark scheme, for its polylines.
        row_titles: `R` names of the projection types.
        scores: Method id to `(R,)` mean squared errors in squared normalised units, or NaN.
        photos: What the views were detected in, drawn in their place.
    """
    width, height, _ = np.ptp(truth, axis=1).max(axis=0)
    pitch_x, pitch_y = width + _GAP, 2 * height + _GAP + _ROW_GAP
    columns = np.arange(3 + len(predictions)) * pitch_x
    extent = (
        -width / 2 - _MARGIN,
        columns[-1] + width / 2 + _GAP,
        -len(truth) * pitch_y + _ROW_GAP / 3,
        _HEAD,
    )
    size = (extent[1] - extent[0], extent[3] - extent[2])
    figure = Figure(figsize=[side * _INCHES_PER_UNIT for side in size])
    axes = figure.add_axes((0, 0, 1, 1))
    bare(axes, extent)
    wire = partial(draw_wireframe, axes, polylines=scheme.polylines)
    write = partial(axes.text, ha="center", color=INK, size=7)

    heads = [("Input view", INK), ("Frontal view found", INK), ("Ground truth", INK)]
    heads += [(title(method), colour(method)) for method in predictions]
    for x, (name, ink) in zip(columns, heads, strict=True):
        # Long words stay whole: a column is about as wide as twelve letters.
        lines = "\n".join(textwrap.wrap(name, 12, break_long_words=False))
        write(x, 0.08, lines, va="bottom", color=ink, weight="bold")

    for row, row_title in enumerate(row_titles):
        top = -row * pitch_y
        front_y, side_y = top - height / 2, top - 1.5 * height - _GAP
        middle_y, score_y = (front_y + side_y) / 2, side_y - height / 2 - 0.05
        if row:
            axes.axhline(top + _ROW_GAP / 3, color="#DDDDDD", linewidth=0.5)
        write(extent[0] + 0.14, middle_y, row_title, rotation=90, va="center", size=7.5)

        if photos is None:
            wire(np.add(_fit(views[row], width, height), (columns[0], middle_y)), colour=INK)
        else:
            _draw_photo(axes, photos, row, (columns[0], middle_y), width + _GAP)

        beneath = _similar(front_view(truth[row]), frontal[row])
        scale = np.ptp(truth[row, :, 1]) / np.ptp(beneath[:, 1])
        shift = (columns[1], middle_y) - scale * _centre(beneath)
        wire(scale * beneath + shift, colour=TRUTH_COLOUR)
        wire(scale * frontal[row] + shift, colour=INK)

        for see, y in ((front_view, front_y), (side_view, side_y)):
            true_points = see(truth[row])
            origin = _centre(true_points)
            wire(true_points - origin + (columns[2], y), colour=INK)
            for x, (method, shapes) in zip(columns[3:], predictions.items(), strict=True):
                if np.isnan(shapes[row]).any():
                    write(x, y, "N/A", va="center")
                    continue
                wire(true_points - origin + (x, y), colour=TRUTH_COLOUR)
                wire(see(shapes[row]) - origin + (x, y), colour=colour(method))

        write(columns[2], score_y, "MSE ($10^{-4}$)", va="top")
        best = min((s for s in (scores[m][row] for m in predictions) if s == s), default=None)
        for x, method in zip(columns[3:], predictions, strict=True):
            score = scores[method][row]
            if np.isnan(score):
                continue
            digits = f"{score * 1e4:#.3g}".rstrip(".")
            write(x, score_y, digits, va="top", weight="bold" if score == best else "normal")
    return figure


def _draw_photo(axes, photos: Photos, row: int, place: tuple[float, float], side: float) -> None:
    image, pixels = photos.images[row], photos.landmarks[row]
    left, bottom = np.subtract(place, side / 2)
    extent = (left, left + side, bottom, bottom + side)
    axes.imshow(image, extent=extent, interpolation="none", zorder=1)
    points = pixels * (1, -1) * side / len(image) + (left, bottom + side)
    axes.scatter(*points.T, s=0.8, c="#FFD000", linewidths=0, zorder=2)


def _centre(points: np.ndarray) -> np.ndarray:
    return (points.min(axis=0) + points.max(axis=0)) / 2


def _fit(points: np.ndarray, width: float, height: float) -> np.ndarray:
    """Centred on zero and scaled to fill a box."""
    scale = min((width, height) / np.ptp(points, axis=0))
    return scale * (points - _centre(points))


def _similar(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """`source` shifted and scaled, but not rotated, to lie nearest `target`."""
    centred = source - source.mean(axis=0)
    scale = np.sum(centred * (target - target.mean(axis=0))) / np.sum(centred**2)
    return scale * centred + target.mean(axis=0)
