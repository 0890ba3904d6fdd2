"""Pictures of faces: contact sheets, and the results of methods on views and photos."""

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from deepmds_keras.landmarks import LandmarkScheme
from experiments.figures.style import DETECTED_COLOUR, INK, TRUTH_COLOUR, look, styled
from experiments.figures.wireframe import (
    bare,
    draw_photo,
    draw_wireframe,
    front_view,
    side_view,
)
from experiments.methods import title
from experiments.scoring.numbers import power
from experiments.scoring.scores import Scores

_PAGE = 7.2  # inches
_INCHES_PER_UNIT = 1.25  # at most: a face is about 0.65 units wide
_GAP = 0.11  # between columns, and between the front and the side view
_ROW_GAP = 0.26  # holds the scores
_HEAD = 0.42  # inches, holds the column titles
_MARGIN = 0.28  # holds the row titles, of up to two lines

_SHEET_COLUMNS = 6
_SHEET_LOOK = {"colour": DETECTED_COLOUR, "linewidth": 0.5, "dot_area": 3.0}
_SHEET_FOOT = 0.25  # inches, holds the legend
_PAD = 0.04  # around each face, in their height


@styled
def qualitative(
    views: np.ndarray,
    frontal: np.ndarray,
    scores: Mapping[str, Scores],
    faces: np.ndarray,
    row_titles: Sequence[str],
    scheme: LandmarkScheme,
    photos: tuple[np.ndarray, np.ndarray] | None = None,
    unit: float = 1e-4,
) -> Figure:
    """Input view, frontal view, truth and every method's shape from the front and the side.

    All shapes have one scale, at which the largest fits; the input views are fitted to the same
    box. The truth is drawn in grey beneath each prediction and beneath the frontal view, which is
    shifted and scaled to fit it best, since it may be normalised by itself. The lowest error of a
    row is bold. N/A marks a face that a method did not find.

    Args:
        views: `(n, L, 2)`.
        frontal: `(n, L, 2)`, the autoencoder's output for `views`.
        scores: Method id to its scores on these faces.
        faces: Numbers of the R faces to draw, one per row.
        row_titles: `R` names of these.
        photos: `(R, S, S, 3)` uint8 in which the views were detected, drawn in their place, and
            landmarks `(R, L, 2)` in their pixels, y down.
        unit: Power of ten in which errors are counted.
    """
    truth = next(iter(scores.values())).truth[faces]
    centres = _middle(truth)
    true_fronts = front_view(truth - centres)
    fitted = [*map(_fit_without_rotation, frontal[faces], true_fronts)]
    drawn = [truth - centres, *(score.aligned[faces] - centres for score in scores.values())]
    reach = np.nanmax(np.abs(np.concatenate(drawn)), axis=(0, 1))
    reach[:2] = np.maximum(reach[:2], np.abs(fitted).max(axis=(0, 1)))
    width, height = 2 * max(reach[0], reach[2]), 2 * reach[1]
    side, top = width + _GAP, height + _GAP / 2
    extent = (-side / 2, side / 2, -top - _ROW_GAP, top)
    heads = ["Input view", "Frontal view", "Ground truth", *map(title, scores)]
    size = np.array([len(heads) * side + _MARGIN, len(truth) * (2 * top + _ROW_GAP)])
    size *= min(_INCHES_PER_UNIT, _PAGE / size[0])
    size[1] += _HEAD
    figure = Figure(figsize=size)
    panels = figure.subplots(len(truth), len(heads), squeeze=False)
    left, below = _MARGIN / (len(heads) * side + _MARGIN), 1 - _HEAD / size[1]
    figure.subplots_adjust(left=left, right=1, bottom=0, top=below, wspace=0, hspace=0)
    for axes, name in zip(panels[0], heads, strict=True):
        # Long words stay whole: a column is about as wide as twelve letters.
        lines = textwrap.fill(name, 12, break_long_words=False)
        _write(axes, (0, top + 0.04), lines, va="bottom", weight="bold", size=6)
    grey = Line2D([], [], color=TRUTH_COLOUR, label="ground truth")
    figure.legend(handles=[grey], loc="lower left")

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
            view = scale * (views[face] - _middle(views[face]))
            draw_wireframe(view_axes, view, scheme.polylines, colour=INK)
        else:
            image, pixels = photos[0][row], photos[1][row]
            box = (-side / 2, side / 2, -side / 2, side / 2)
            view_axes.imshow(image, extent=box, interpolation="none", zorder=1)
            points = (pixels / len(image) - 0.5) * (side, -side)
            view_axes.scatter(*points.T, s=0.8, c=DETECTED_COLOUR, linewidths=0, zorder=2)

        for points, ink in ((true_fronts[row], TRUTH_COLOUR), (fitted[row], INK)):
            draw_wireframe(frontal_axes, points, scheme.polylines, colour=ink)

        true_shape, places = truth[row] - centres[row], ((0, top / 2), (0, -top / 2))
        _draw_views(truth_axes, true_shape, scheme, TRUTH_COLOUR, places)
        _write(truth_axes, score_place, f"MSE ({power(unit)})", va="top")
        of_row = [score.mse[face] for score in scores.values()]
        for axes, (method, score) in zip(others, scores.items(), strict=True):
            if not score.detected[face]:
                _write(axes, (0, 0), "N/A", va="center")
                continue
            _draw_views(axes, true_shape, scheme, TRUTH_COLOUR, places)
            _draw_views(
                axes, score.aligned[face] - centres[row], scheme, look(method).colour, places
            )
            digits = f"{score.mse[face] / unit:#.3g}".rstrip(".")
            weight = "bold" if score.mse[face] == np.nanmin(of_row) else "normal"
            _write(axes, score_place, digits, va="top", weight=weight)
    return figure


def _write(axes: Axes, place: tuple[float, float], text: str, **look) -> None:
    axes.text(*place, text, **{"ha": "center", "color": INK, "size": 7, **look})


def _draw_views(
    axes: Axes, shape: np.ndarray, scheme: LandmarkScheme, ink: str, places: Sequence
) -> None:
    """Draw a shape from the front at the first of two places and from the side at the other."""
    for view, place in zip((front_view, side_view), places, strict=True):
        draw_wireframe(axes, view(shape) + place, scheme.polylines, colour=ink)


def _middle(points: np.ndarray) -> np.ndarray:
    """Middle of the box around points `(..., L, d)`: `(..., 1, d)`."""
    return (points.min(axis=-2, keepdims=True) + points.max(axis=-2, keepdims=True)) / 2


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
    row_titles: Sequence[str],
    scheme: LandmarkScheme,
) -> Figure:
    """A row for each photo: its name, the photo, each method's shape from the front and the side.

    Args:
        images: `(n, size, size, 3)` uint8.
        landmarks: `(n, L, 2)` pixels, x right and y down.
        shapes: Method id to `(n, L, 3)`, all in one frame and of about one size; NaN where a method
            did not find the face.
        row_titles: `n` names of the photos.
    """
    known = np.concatenate([predicted.reshape(-1, 3) for predicted in shapes.values()])
    low, high = np.nanmin(known, axis=0), np.nanmax(known, axis=0)
    centre, (width, height, depth) = (low + high) / 2, high - low
    pad = _PAD * height
    across, down = width + depth + 3 * pad, height + 2 * pad
    widths = [1.0, *[across / down] * len(shapes)]
    inches = (_PAGE - _HEAD / 2) / sum(widths)  # of a photo's side
    size = _PAGE, inches * len(images) + _HEAD
    figure = Figure(figsize=size)
    panels = figure.subplots(len(images), len(widths), squeeze=False, width_ratios=widths)
    figure.subplots_adjust(_HEAD / 2 / _PAGE, 0, 1, 1 - _HEAD / size[1], 0.02, 0.02)
    for row, (first, *others) in enumerate(panels):
        draw_photo(first, images[row])
        at_side = {"transform": first.transAxes, "rotation": 90, "va": "center"}
        _write(first, (-_HEAD / 4 / inches, 0.5), row_titles[row], **at_side)
        yellow = {"colour": DETECTED_COLOUR, "dot_area": 1}
        draw_wireframe(first, landmarks[row], scheme.polylines, **yellow)
        for axes, (method, predicted) in zip(others, shapes.items(), strict=True):
            axes.set_axis_off()
            if np.isnan(predicted[row]).any():
                axes.text(0.5, 0.5, "N/A", ha="center", transform=axes.transAxes, color=INK)
                continue
            places = (-(depth + pad) / 2, 0), ((width + pad) / 2, 0)
            _draw_views(axes, predicted[row] - centre, scheme, look(method).colour, places)
            bare(axes, (-across / 2, across / 2, -down / 2, down / 2))
    for axes, name in zip(panels[0], ("Photo", *map(title, shapes)), strict=True):
        axes.set_title(textwrap.fill(name, 16), color=INK, weight="bold", fontsize=6.5)
    return figure


@styled
def renders(images: np.ndarray, landmarks: np.ndarray, scheme: LandmarkScheme) -> Figure:
    """A contact sheet in rows of six, with landmarks drawn in the lower half of the rows.

    Args:
        images: `(n, size, size, 3)` uint8.
        landmarks: `(n, L, 2)` pixels, x right and y down from the left upper corner.
    """
    n_rows = -(-len(images) // _SHEET_COLUMNS)
    height = n_rows * _PAGE / _SHEET_COLUMNS + _SHEET_FOOT
    figure = Figure(figsize=(_PAGE, height))
    figure.subplots_adjust(0, _SHEET_FOOT / height, 1, 1, 0.03, 0.03)
    panels = figure.subplots(n_rows, _SHEET_COLUMNS, squeeze=False).ravel()
    for axes in panels[len(images) :]:
        axes.set_axis_off()
    for number, (axes, image) in enumerate(zip(panels, images, strict=False)):
        draw_photo(axes, image)
        if number >= len(images) // 2:
            draw_wireframe(axes, landmarks[number], scheme.polylines, **_SHEET_LOOK)
    dots = {"ls": "", "marker": ".", "mec": INK, "mew": 0.3}
    label = "landmarks, in the lower half only"
    figure.legend(
        handles=[Line2D([], [], color=DETECTED_COLOUR, **dots, label=label)], loc="lower center"
    )
    return figure
