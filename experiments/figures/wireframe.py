"""A face drawn as its landmarks, joined by polylines, seen from the front or the side."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection


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
    polylines: tuple[tuple[int, ...], ...],
    *,
    colour: str,
    linewidth: float = 0.6,
    dot_area: float = 1.6,
    zorder: float = 2,
) -> None:
    """Draw one face into `axes`, in data units.

    Args:
        axes: Needs an equal aspect for the face to keep its proportions.
        points: `(L, 2)`, as given by `front_view` or `side_view`.
        polylines: 0-based landmark numbers of every line, `scheme.polylines`.
        colour: Of lines and dots.
        linewidth: In points; 0 leaves the lines out.
        dot_area: In points squared; 0 leaves the dots out.
        zorder: Higher is drawn later.
    """
    if linewidth:
        axes.add_collection(
            LineCollection(
                [points[list(line)] for line in polylines],
                colors=colour,
                linewidths=linewidth,
                capstyle="round",
                joinstyle="round",
                zorder=zorder,
            )
        )
    if dot_area:
        axes.scatter(*points.T, s=dot_area, c=colour, linewidths=0, zorder=zorder)


def bare(axes: Axes, extent: tuple[float, float, float, float]) -> None:
    """Equal aspect, no frame, and the limits `(left, right, bottom, top)`."""
    axes.set(xlim=extent[:2], ylim=extent[2:], aspect="equal")
    axes.set_axis_off()
