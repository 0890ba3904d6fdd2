"""A landmark scheme on a face: every landmark with its number, joined by the scheme's lines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from experiments.figures.style import INK, styled
from experiments.figures.wireframe import draw_wireframe

DPI = 160
_FONT = 10.5  # points: on a phone, which shows the picture at about 0.4 of its size, still 9 pixels
_BOX = np.array([(19.0, 22.0), (35.0, 22.0), (51.0, 22.0)])  # pixels of one, two, three digits
_PALE = 0.5  # share of white in the photo, so that what is drawn on it stands out
_STEP = 5  # of the photo’s colours, which halves the bytes of the picture
# Of Okabe and Ito's palette, darkened where it is read as text.
_COLOURS = {
    "brow": "#B34700",
    "eye": "#005B96",
    "nose": "#00674A",
    "outer_mouth": "#A6266E",
    "inner_mouth": "#5B2A86",
    "jaw": INK,
    "chin": INK,
}
_RADII, _ANGLES = np.linspace(18, 90, 13), np.linspace(0, 2 * np.pi, 24, endpoint=False)
_SPOTS = (_RADII[:, None, None] * np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)).reshape(
    -1, 2
)  # pixels from a landmark to where its number may stand
_ALONG = np.linspace(0.25, 0.8, 5)[:, None]  # places on a leader by which it is kept off numbers
_CLEAR = 8.0  # pixels between a number and the landmarks of others
_PASSES = 8


@styled
def numbered(
    image: np.ndarray,
    points: np.ndarray,
    labels: Sequence[str],
    groups: Sequence[str],
    polylines: Sequence[Sequence[int]],
) -> Figure:
    """The landmarks on a picture of a face, a colour a facial part, as large as the picture.

    Args:
        image: `(H, W, 3)` uint8.
        points: `(L, 2)` pixels, x right and y down from the left upper corner.
        labels: L short texts, the numbers, of up to three digits.
        groups: L names of facial parts, as `LandmarkScheme.groups`.
        polylines: Lines of 0-based landmarks.
    """
    height, width = image.shape[:2]
    figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    pale = np.uint8(255 * _PALE + (1 - _PALE) * image) // _STEP * _STEP
    axes.imshow(pale, extent=(0, width, height, 0), interpolation="nearest")
    draw_wireframe(axes, points, polylines, colour="white", linewidth=1.2, dot_area=0)
    colours = [_COLOURS[group.removeprefix("right_").removeprefix("left_")] for group in groups]
    spots = place_numbers(points, labels)
    halo = [withStroke(linewidth=2, foreground="white")]
    for point, spot, half, label, colour in zip(
        points, spots, _halves(labels), labels, colours, strict=True
    ):
        way = spot - point
        end = point + way * (1 - (half / np.abs(way).clip(1e-9)).min())
        axes.plot(*np.stack([point, end], axis=1), color=colour, lw=0.9)
        axes.text(
            *spot,
            label,
            size=_FONT,
            color=colour,
            ha="center",
            va="center_baseline",
            weight="bold",
            path_effects=halo,
        )
    axes.scatter(*points.T, s=16, c=colours, linewidths=0.6, edgecolors="white", zorder=4)
    for x, side, align in ((0.015, "subject’s right", "left"), (0.985, "subject’s left", "right")):
        axes.text(x, 0.015, side, transform=axes.transAxes, ha=align, size=_FONT, color=INK)
    axes.set(xlim=(0, width), ylim=(height, 0))
    return figure


def place_numbers(points: np.ndarray, labels: Sequence[str]) -> np.ndarray:
    """Where the numbers stand: near their landmarks, off each other and off every landmark.

    Each in turn takes the best of a ring of places, given those of the others, a few times over.

    Args:
        points: `(L, 2)` pixels.
        labels: L texts of one to three characters.

    Returns:
        `(L, 2)` pixels, the middle of each text.
    """
    half = _halves(labels)
    spots = points + _SPOTS[0]
    everyone = np.arange(len(points))
    for _ in range(_PASSES):
        before = spots.copy()
        for i in everyone:
            others = everyone != i
            candidates = points[i] + _SPOTS
            leaders = points[others] + _ALONG[:, None] * (spots[others] - points[others])
            own = points[i] + _ALONG[:, None] * (candidates - points[i])
            reach = half[i] + half[others]
            crowding = (
                np.prod((reach - np.abs(candidates[:, None] - spots[others])).clip(0), axis=2),
                100.0 * _inside(points[i : i + 1], candidates[:, None], half[i] + 3),
                100.0 * _inside(points[others], candidates[:, None], half[i] + _CLEAR),
                50.0 * _inside(leaders.reshape(-1, 2), candidates[:, None], half[i]),
                50.0 * _inside(own[:, :, None], spots[others], half[others]).sum(0),
                50.0 * _inside(own[:, :, None], points[others], 4.0).sum(0),
                100.0 * _crossing(points[i], candidates, points[others], spots[others]),
            )
            cost = np.linalg.norm(_SPOTS, axis=1) + sum(part.sum(-1) for part in crowding)
            spots[i] = candidates[cost.argmin()]
        if (spots == before).all():
            break
    return spots


def _halves(labels: Sequence[str]) -> np.ndarray:
    """Half the width and height of each text, `(L, 2)` pixels."""
    return _BOX[[len(label) - 1 for label in labels]] / 2


def _inside(points: np.ndarray, middles: np.ndarray, half: np.ndarray | float) -> np.ndarray:
    """Mask of points in boxes, given by their middles and half sizes; shapes as broadcast."""
    return (np.abs(points - middles) < half).all(-1)


def _crossing(
    start: np.ndarray, ends: np.ndarray, starts: np.ndarray, others: np.ndarray
) -> np.ndarray:
    """Mask of lines from one start that cross other lines: `(K, 2)`, `(M, 2)` twice → `(K, M)`."""

    def side(a, b, c):
        u, v = b - a, c - a
        return np.sign(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])

    ends = ends[:, None]
    apart = side(start, ends, starts) != side(start, ends, others)
    return apart & (side(starts, others, start) != side(starts, others, ends))
