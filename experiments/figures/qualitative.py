"""Pictures of faces: contact sheets, and the results of methods on views and photos."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.figures.style import DETECTED_COLOUR, INK, TRUTH_COLOUR, colour, styled
from experiments.figures.wireframe import (
    bare,
    draw_photo,
    draw_wireframe,
    front_view,
    side_view,
)
from experiments.methods import title

if TYPE_CHECKING:
    from deepmds_keras.landmarks import LandmarkScheme
    from experiments.scoring.scores import Scores

_INCHES_PER_UNIT = 1.25  # a face is about 0.65 units wide: 0.8 inch, twelve of them on a page
_GAP = 0.11  # between columns, and between the front and the side view
_ROW_GAP = 0.26  # holds the scores
_HEAD = 0.42  # holds the column titles
_MARGIN = 0.28  # holds the row titles, of up to two lines

_SHEET_COLUMNS = 6
_SHEET_INCHES = 0.6  # 96 pixels, those of the image, at the resolution of `style.save`
_PHOTO_INCHES, _PHOTO_HEAD = 1.15, 0.42
_HALF = 0.58  # half the height of a panel of shapes, relative to theirs
_ASPECT = 1.45  # width of a face's front and side view side by side, per height


@styled
def qualitative(
    views: np.ndarray,
    frontal: np.ndarray,
    scores: Mapping[str, Scores],
    faces: np.ndarray,
    row_titles: Sequence[str],
    scheme: LandmarkScheme,
    photos: tuple[np.ndarray, np.ndarray] | None = None,
) -> Figure:
    """Input view, frontal view, truth and every method's shape from the front and the side.

    All shapes have one scale; the input views are fitted to the same box. The truth is drawn in
    grey beneath each prediction and beneath the frontal view, which is shifted and scaled to fit
    it best, since it may be normalised by itself. The lowest error of a row is bold. N/A marks a
    face that a method did not find.

    Args:
        views: `(n, L, 2)`.
        frontal: `(n, L, 2)`, the autoencoder's output for `views`.
        scores: Method id to its scores on these faces.
        faces: Numbers of the R faces to draw, one per row.
        row_titles: `R` names of these.
        scheme: Landmark scheme, for its polylines.
        photos: `(R, S, S, 3)` uint8 in which the views were detected, drawn in their place, and
            landmarks `(R, L, 2)` in their pixels, y down.
    """
    truth = next(iter(scores.values())).truth[faces]
    width, height, _ = np.ptp(truth, axis=1).max(axis=0)
    side, top = width + _GAP, height + _GAP / 2
    extent = (-side / 2, side / 2, -top - _ROW_GAP, top)
    heads = [("Input view", INK), ("Frontal view", INK), ("Ground truth", INK)]
    heads += [(title(method), colour(method)) for method in scores]
    size = np.array([len(heads) * side + _MARGIN, len(truth) * (2 * top + _ROW_GAP) + _HEAD])
    figure = Figure(figsize=size * _INCHES_PER_UNIT)
    panels = figure.subplots(len(truth), len(heads), squeeze=False)
    left, below = _MARGIN / size[0], 1 - _HEAD / size[1]
    figure.subplots_adjust(left=left, right=1, bottom=0, top=below, wspace=0, hspace=0)
    for axes, (name, ink) in zip(panels[0], heads, strict=True):
        # Long words stay whole: a column is about as wide as twelve letters.
        lines = textwrap.fill(name, 12, break_long_words=False)
        _write(axes, (0, top + 0.08), lines, va="bottom", color=ink, weight="bold")

    for row, face in enumerate(faces):
        view_axes, frontal_axes, truth_axes, *others = panels[row]
        for axes in panels[row]:
            bare(axes, extent)
            if row:
                axes.axhline(top, color="#DDDDDD", linewidth=0.5)
        title_place, score_place = (-side / 2 - _MARGIN / 2, 0), (0, -top - _GAP / 2)
        _write(view_axes, title_place, row_titles[row], rotation=90, va="center", size=7.5)
        if photos is None:
            scale = min((width, height) / np.ptp(views[face], axis=0))
            view = scale * (views[face] - _centre(views[face]))
            draw_wireframe(view_axes, view, scheme.polylines, colour=INK)
        else:
            image, pixels = photos[0][row], photos[1][row]
            box = (-side / 2, side / 2, -side / 2, side / 2)
            view_axes.imshow(image, extent=box, interpolation="none", zorder=1)
            points = (pixels / len(image) - 0.5) * (side, -side)
            view_axes.scatter(*points.T, s=0.8, c=DETECTED_COLOUR, linewidths=0, zorder=2)

        true_front = front_view(truth[row]) - _centre(front_view(truth[row]))
        fitted = _fit_without_rotation(frontal[face], true_front)
        for points, ink in ((true_front, TRUTH_COLOUR), (fitted, INK)):
            draw_wireframe(frontal_axes, points, scheme.polylines, colour=ink)

        _draw_views(truth_axes, truth[row], truth[row], scheme, INK, top / 2)
        _write(truth_axes, score_place, "MSE ($10^{-4}$)", va="top")
        of_row = [score.mse[face] for score in scores.values()]
        for axes, (method, score) in zip(others, scores.items(), strict=True):
            if not score.detected[face]:
                _write(axes, (0, 0), "N/A", va="center")
                continue
            _draw_views(axes, truth[row], truth[row], scheme, TRUTH_COLOUR, top / 2)
            _draw_views(axes, score.aligned[face], truth[row], scheme, colour(method), top / 2)
            digits = f"{score.mse[face] * 1e4:#.3g}".rstrip(".")
            weight = "bold" if score.mse[face] == np.nanmin(of_row) else "normal"
            _write(axes, score_place, digits, va="top", weight=weight)
    return figure


def _write(axes: Axes, place: tuple[float, float], text: str, **look) -> None:
    axes.text(*place, text, **{"ha": "center", "color": INK, "size": 7, **look})


def _draw_views(
    axes: Axes, shape: np.ndarray, truth: np.ndarray, scheme: LandmarkScheme, ink: str, y: float
) -> None:
    """Draw a shape from the front and, below it, from the side, with the truth centred."""
    for view, shift in ((front_view, y), (side_view, -y)):
        points = view(shape) - _centre(view(truth)) + (0, shift)
        draw_wireframe(axes, points, scheme.polylines, colour=ink)


def _centre(points: np.ndarray) -> np.ndarray:
    return (points.min(axis=0) + points.max(axis=0)) / 2


def _fit_without_rotation(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """`source`, shifted and scaled but not rotated, to fit `target` best."""
    centred = source - source.mean(axis=0)
    scale = np.sum(centred * (target - target.mean(axis=0))) / np.sum(centred**2)
    return scale * centred + target.mean(axis=0)


@styled
def gallery(
    images: np.ndarray,
    landmarks: np.ndarray,
    shapes: Mapping[str, np.ndarray],
    scheme: LandmarkScheme,
) -> Figure:
    """A row for each photo: the photo, and each method's shape from the front and the side.

    Args:
        images: `(n, size, size, 3)` uint8.
        landmarks: `(n, L, 2)` pixels, x right and y down.
        shapes: Method id to `(n, L, 3)`, all in one frame and of about one size; NaN where a method
            did not find the face.
        scheme: Landmark scheme, for its polylines.
    """
    widths = [1.0, *[_ASPECT] * len(shapes)]
    size = _PHOTO_INCHES * sum(widths), _PHOTO_INCHES * len(images) + _PHOTO_HEAD
    figure = Figure(figsize=size)
    panels = figure.subplots(len(images), len(widths), squeeze=False, width_ratios=widths)
    figure.subplots_adjust(0, 0, 1, 1 - _PHOTO_HEAD / size[1], 0.02, 0.02)
    known = np.concatenate([predicted.reshape(-1, 3) for predicted in shapes.values()])
    half = _HALF * (np.nanmax(known[:, 1]) - np.nanmin(known[:, 1]))
    for row, (first, *others) in enumerate(panels):
        draw_photo(first, images[row])
        yellow = {"colour": DETECTED_COLOUR, "dot_area": 1}
        draw_wireframe(first, landmarks[row], scheme.polylines, **yellow)
        for axes, (method, predicted) in zip(others, shapes.items(), strict=True):
            axes.set_axis_off()
            if np.isnan(predicted[row]).any():
                axes.text(0.5, 0.5, "N/A", ha="center", transform=axes.transAxes, color=INK)
                continue
            shape = predicted[row] - np.nanmean(known, axis=0)
            for points, x in ((front_view(shape), -0.6 * half), (side_view(shape), 0.95 * half)):
                draw_wireframe(axes, points + (x, 0), scheme.polylines, colour=colour(method))
            bare(axes, (-_ASPECT * half, _ASPECT * half, -half, half))
    heads = [("Photo", INK), *((title(method), colour(method)) for method in shapes)]
    for axes, (name, ink) in zip(panels[0], heads, strict=True):
        axes.set_title(textwrap.fill(name, 16), color=ink, weight="bold", fontsize=7.5)
    return figure


@styled
def renders(images: np.ndarray, landmarks: np.ndarray, scheme: LandmarkScheme) -> Figure:
    """A contact sheet in rows of six, with landmarks drawn in the lower half of the rows.

    Args:
        images: `(n, size, size, 3)` uint8.
        landmarks: `(n, L, 2)` pixels, x right and y down from the left upper corner.
        scheme: Landmark scheme, for its polylines.
    """
    n_rows = -(-len(images) // _SHEET_COLUMNS)
    figure = Figure(figsize=(_SHEET_COLUMNS * _SHEET_INCHES, n_rows * _SHEET_INCHES))
    figure.subplots_adjust(0, 0, 1, 1, 0, 0)
    panels = figure.subplots(n_rows, _SHEET_COLUMNS, squeeze=False).ravel()
    for axes in panels[len(images) :]:
        axes.set_axis_off()
    for number, (axes, image) in enumerate(zip(panels, images, strict=False)):
        draw_photo(axes, image)
        if number >= len(images) // 2:
            lines = {"colour": "#00A0FF", "linewidth": 0.4}
            draw_wireframe(axes, landmarks[number], scheme.polylines, **lines, dot_area=0)
            axes.plot(*landmarks[number].T, ".", color=DETECTED_COLOUR, ms=1.6, mew=0)
    return figure
