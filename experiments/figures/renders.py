"""A contact sheet of the images that MobileFace sees, the lower half with their landmarks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from experiments.figures.style import styled

if TYPE_CHECKING:
    from deepmds_keras.landmarks import LandmarkScheme

_COLUMNS = 6
_INCHES = 0.6  # 96 pixels at the resolution of `style.PNG_DPI`: every pixel is one of the image


@styled
def renders(images: np.ndarray, landmarks: np.ndarray, scheme: LandmarkScheme) -> Figure:
    """Images in rows of six; in the lower half of the rows the landmarks are drawn in.

    Args:
        images: `(n, size, size, 3)` uint8.
        landmarks: `(n, L, 2)` pixels, x right and y down from the left upper corner.
        scheme: Landmark scheme, for its polylines.
    """
    size = images.shape[1]
    rows = -(-len(images) // _COLUMNS)
    figure = Figure(figsize=(_COLUMNS * _INCHES, rows * _INCHES))
    panels = figure.subplots(rows, _COLUMNS, squeeze=False)
    figure.subplots_adjust(0, 0, 1, 1, 0, 0)
    for axes in panels.flat:
        axes.set_axis_off()
    for number, axes in enumerate(panels.flat[: len(images)]):
        axes.imshow(images[number], extent=(0, size, size, 0), interpolation="nearest")
        if number >= len(images) // 2:
            for line in scheme.polylines:
                axes.plot(*landmarks[number, list(line)].T, color="#00A0FF", lw=0.4)
            axes.plot(*landmarks[number].T, ".", color="#FFD000", ms=1.6, mew=0)
        axes.set(xlim=(0, size), ylim=(size, 0))
    return figure
