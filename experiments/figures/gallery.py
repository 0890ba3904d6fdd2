"""Photos with their landmarks and what every method makes of them, where the truth is not known."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from experiments.figures.style import INK, colour, styled
from experiments.figures.wireframe import bare, draw_wireframe, front_view, side_view
from experiments.methods import title

if TYPE_CHECKING:
    from deepmds_keras.landmarks import LandmarkScheme

_INCHES, _HEAD = 1.15, 0.42  # a side of a photo; the titles


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
    n, size = len(images), images.shape[1]
    widths = [1.0, *[1.45] * len(shapes)]
    figure = Figure(figsize=(_INCHES * sum(widths), _INCHES * n + _HEAD))
    panels = figure.subplots(n, len(widths), squeeze=False, gridspec_kw={"width_ratios": widths})
    figure.subplots_adjust(0, 0, 1, 1 - _HEAD / figure.get_figheight(), 0.02, 0.02)
    known = np.concatenate([own.reshape(-1, 3) for own in shapes.values()])
    middle = np.nanmean(known, axis=0)
    reach = 0.58 * np.ptp(known[np.isfinite(known).all(1), 1])
    for row, panel in enumerate(panels):
        panel[0].imshow(images[row], extent=(0, size, size, 0))
        draw_wireframe(panel[0], landmarks[row], scheme.polylines, colour="#FFD000", dot_area=1)
        bare(panel[0], (0, size, size, 0))
        for axes, (method, own) in zip(panel[1:], shapes.items(), strict=True):
            bare(axes, (-1.45 * reach, 1.45 * reach, -reach, reach))
            if np.isnan(own[row]).any():
                axes.text(0, 0, "N/A", ha="center", va="center", color=INK)
                continue
            shape = own[row] - middle
            for points, shift in ((front_view(shape), -0.6), (side_view(shape), 0.95)):
                place = points + np.array([shift * reach, 0])
                draw_wireframe(axes, place, scheme.polylines, colour=colour(method))
    heads = [("Photo", INK), *((title(method), colour(method)) for method in shapes)]
    for axes, (name, ink) in zip(panels[0], heads, strict=True):
        lines = "\n".join(textwrap.wrap(name, 16))
        axes.set_title(lines, color=ink, weight="bold", fontsize=7.5)
    return figure
