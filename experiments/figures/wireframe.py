"""Draws a face as landmarks joined by polylines, seen from the front or the side."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection

from experiments.figures.style import INK, TRUTH_COLOUR

Polylines = Sequence[Sequence[int]]


def front_view(shape: np.ndarray) -> np.ndarray:
    """`(..., L, 3)` to `(..., L, 2)`: x to the right, y up.

    The viewer faces the subject, whose left (+x) is therefore on the right of the picture.
    """
    return shape[..., :2]


def side_view(shape: np.ndarray) -> np.ndarray:
    """`(..., L, 3)` to `(..., L, 2)`: z to the right, y up; the nose points to the right."""
    return shape[..., [2, 1]]


def draw_wireframe(
    axes: Axes,
    points: np.ndarray,
    polylines: Polylines,
    *,
    colour: str,
    linewidth: float = 0.6,
    dot_area: float = 1.6,
) -> None:
    """Draw points `(L, 2)` of a face, in data units, and lines of 0-based landmarks.

    The width of lines is in points, the area of a dot in points squared; 0 leaves the dots out.
    """
    lines = [points[list(line)] for line in polylines]
    style = {"colors": colour, "linewidths": linewidth, "zorder": 2}
    axes.add_collection(LineCollection(lines, capstyle="round", joinstyle="round", **style))
    if dot_area:
        axes.scatter(*points.T, s=dot_area, c=colour, linewidths=0, zorder=2)


def draw_error_map(
    axes: Axes, shape: np.ndarray, polylines: Polylines, errors: np.ndarray, colours: ScalarMappable
) -> None:
    """Draw a face `(L, 3)` from the front, each landmark coloured by its error, of `(L,)`."""
    points = front_view(shape)
    pad = 0.05 * np.ptp(points[:, 1])
    (left, bottom), (right, top) = points.min(0) - pad, points.max(0) + pad
    bare(axes, (left, right, bottom, top))
    draw_wireframe(axes, points, polylines, colour=TRUTH_COLOUR, dot_area=0)
    ink = {"c": colours.to_rgba(errors), "edgecolors": INK, "linewidths": 0.3}
    axes.scatter(*points.T, s=15, zorder=3, **ink)


def draw_photo(axes: Axes, image: np.ndarray) -> None:
    """Draw a photo `(H, W, 3)` in pixels, x right and y down from the left upper corner."""
    height, width = image.shape[:2]
    axes.imshow(image, extent=(0, width, height, 0), interpolation="none")
    bare(axes, (0, width, height, 0))


def bare(axes: Axes, extent: tuple[float, float, float, float]) -> None:
    """Equal aspect, no frame, and the limits `(left, right, bottom, top)`."""
    axes.set(xlim=extent[:2], ylim=extent[2:], aspect="equal")
    axes.set_axis_off()
