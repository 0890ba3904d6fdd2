"""Pictures of 3D faces: one beside its photo, and a contact sheet of many."""

from __future__ import annotations

import functools
import io
import textwrap
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font

from deepmds_keras.landmarks import load_scheme
from deepmds_keras.predict.cutout import cut_out
from deepmds_keras.predict.faces import Face
from deepmds_keras.predict.outputs import SCALE
from deepmds_keras.predict.writing import write_bytes

_DPI = 160  # 1200 pixels of 7.5 inches
_WIDTH = 7.5
_RC = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same on every machine
    "font.size": 7.5,
    "text.parse_math": False,  # a file name may have two dollars in it
    "axes.titlesize": 8,
    "axes.labelsize": 7,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.edgecolor": "#8A8A8A",
    "axes.grid": True,
    "grid.color": "#EAEAEA",
    "grid.linewidth": 0.5,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.color": "#555555",
    "ytick.color": "#555555",
}
_SHAPE_COLOUR, _SEEN_COLOUR, _DOT_COLOUR = "#D55E00", "#FF9448", "#FFD000"
_INK, _WARNING = "#333333", "#8A4B00"
_THREE_QUARTERS = 40  # degrees, to the subject's left
_SHEET_FACES, _SHEET_COLUMNS = 24, 4
_LINE = 165  # characters of small type across the picture
_TITLE_LENGTH = 70


def _styled(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    """Draws with `_RC`, whatever the caller's settings are."""

    @functools.wraps(draw)
    def wrapper(*args, **kwargs):
        with matplotlib.rc_context(_RC):
            return draw(*args, **kwargs)

    return wrapper


@_styled
def draw_face(face: Face, photo: np.ndarray | None) -> Figure:
    """The photo about the face, and the shape from the front, from three quarters and the side.

    The three views have one scale, and one y.

    Args:
        face: The face.
        photo: All of its photo, `(H, W, 3)` uint8 RGB, or None: the landmarks alone are drawn.
    """
    views = [("Front", _turned(face.shape, 0)), ("Side", _turned(face.shape, 90))]
    views.insert(1, ("Three quarters", _turned(face.shape, _THREE_QUARTERS)))
    middles = [(points.min(0) + points.max(0)) / 2 for _, points in views]
    height = 1.12 * np.ptp(face.shape[:, 1])
    widths = [np.ptp(points[:, 0]) + height - np.ptp(points[:, 1]) for _, points in views]

    lines = _small_type(face)
    left, gaps, right = 0.1 if photo is not None else 0.47, (0.55, 0.12, 0.12), 0.1
    side = (_WIDTH - left - sum(gaps) - right) / (1 + sum(widths) / height)
    head, foot = 0.5, 0.55 + 0.14 * len(lines)
    total = head + side + foot
    figure = Figure(figsize=(_WIDTH, total))

    def panel(x: float, width: float) -> Axes:
        return figure.add_axes((x / _WIDTH, foot / total, width / _WIDTH, side / total))

    _draw_view(panel(left, side), face, photo, ticks=photo is None)
    x = left + side
    for gap, (title, points), middle, width in zip(gaps, views, middles, widths, strict=True):
        x += gap
        axes = panel(x, width / height * side)
        x += width / height * side
        _draw_lines(axes, points, face, _SHAPE_COLOUR, _SHAPE_COLOUR)
        axes.set(
            title=title,
            xlim=middle[0] + np.array([-0.5, 0.5]) * width,
            ylim=middle[1] + np.array([-0.5, 0.5]) * height,
        )
        axes.locator_params(axis="y", nbins=4)
        axes.locator_params(axis="x", nbins=4 if width > height / 2 else 2)
        axes.tick_params(length=2)
        if title == "Front":
            axes.set(xlabel=f"x ({face.unit})", ylabel=f"y ({face.unit})")
            continue
        axes.tick_params(labelleft=False)
        if title == "Side":
            axes.set_xlabel(f"z ({face.unit})")
        else:
            axes.set_xlabel(f"turned by {_THREE_QUARTERS}°")
            axes.tick_params(bottom=False, labelbottom=False)

    x, title = 0.1 / _WIDTH, {"size": 9, "weight": "bold"}
    figure.text(x, 1 - 0.1 / total, _short(face.name), color=_INK, va="top", **title)
    for row, (line, ink) in enumerate(lines):
        y = (foot - 0.5 - 0.14 * row) / total
        figure.text(x, y, line, size=6.5, color=ink, va="top")
    return figure


@_styled
def draw_summary(faces: Sequence[Face], photos: Iterable[np.ndarray | None]) -> Figure:
    """A contact sheet: each face in its photo and, beside it, its shape from three quarters.

    Args:
        faces: At least one; the first 24 are drawn, and the sheet says of how many.
        photos: As for `draw_face`, of each face. Read one by one, and no further than drawn.
    """
    drawn = faces[:_SHEET_FACES]
    columns = min(_SHEET_COLUMNS, len(drawn))
    head, label, gap = 0.36, 0.17, 0.06
    cell = _WIDTH / _SHEET_COLUMNS
    side = (cell - gap) / 2
    row = side + label + gap
    width, total = columns * cell, head + -(-len(drawn) // columns) * row
    figure = Figure(figsize=(width, total))
    count = f"{len(drawn)} of {len(faces)}" if len(drawn) < len(faces) else f"{len(faces)}"
    title = f"{count} face{'s' * (len(faces) > 1)}"
    figure.text(gap / width, 1 - 0.1 / total, title, size=9, weight="bold", color=_INK, va="top")
    for i, (face, photo) in enumerate(zip(drawn, photos, strict=False)):
        left = i % columns * cell + gap / 2
        bottom = total - head - i // columns * row - side
        for x, draw in ((left, _draw_view), (left + side, _draw_three_quarters)):
            draw(
                figure.add_axes((x / width, bottom / total, side / width, side / total)),
                face,
                photo,
            )
        ink = _WARNING if face.notes else _INK
        x, y = (left + 0.02) / width, (bottom - 0.03) / total
        figure.text(x, y, _short(face.name, 34), size=6.5, color=ink, va="top")
    return figure


def write_picture(path: str | Path, figure: Figure) -> None:
    """Write a figure as PNG, complete or not at all; equal figures give equal bytes.

    Raises:
        InputError: The file cannot be written.
    """
    buffer = io.BytesIO()
    with matplotlib.rc_context(_RC):
        figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": None})
    write_bytes(path, buffer.getvalue())


def _turned(shape: np.ndarray, yaw: float) -> np.ndarray:
    """`(L, 2)` as seen when the head turns to its left; y stays what it is."""
    angle = np.deg2rad(yaw)
    return np.stack([shape[:, 0] * np.cos(angle) + shape[:, 2] * np.sin(angle), shape[:, 1]], 1)


def _draw_lines(
    axes: Axes, points: np.ndarray, face: Face, lines: str, dots: str, dot: float = 5
) -> None:
    drawn = [points[list(line)] for line in load_scheme(face.scheme).polylines]
    axes.add_collection(LineCollection(drawn, colors=lines, linewidths=0.8, capstyle="round"))
    axes.scatter(*points.T, s=dot, c=dots, linewidths=0, zorder=3)


def _draw_view(axes: Axes, face: Face, photo: np.ndarray | None, *, ticks: bool = False) -> None:
    """The photo about the face with its landmarks and the lines of the shape, or the former."""
    points = face.landmarks
    if photo is not None:
        cutout = cut_out(photo, points)
        height, width = cutout.image.shape[:2]
        axes.imshow(cutout.image, extent=(0, width, height, 0))
        _draw_lines(axes, cutout.place(face.seen_shape), face, _SEEN_COLOUR, "none")
        axes.scatter(*cutout.landmarks.T, s=4, c=_DOT_COLOUR, edgecolors=_INK, linewidths=0.25,
                     zorder=4)  # fmt: skip
        axes.set(xlim=(0, width), ylim=(height, 0))
        axes.set_axis_off()
        return
    _draw_lines(axes, points, face, _INK, _INK, 3)
    _square(axes, points)
    axes.invert_yaxis()
    if not ticks:
        axes.set_axis_off()
        return
    axes.locator_params(nbins=4)
    axes.tick_params(length=2)
    axes.set(title="Landmarks given", xlabel="image x")
    axes.set_ylabel("image y", labelpad=1)


def _draw_three_quarters(axes: Axes, face: Face, photo: np.ndarray | None) -> None:
    points = _turned(face.shape, _THREE_QUARTERS)
    _draw_lines(axes, points, face, _SHAPE_COLOUR, _SHAPE_COLOUR, 3)
    _square(axes, points)
    axes.set_axis_off()


def _square(axes: Axes, points: np.ndarray) -> None:
    """Equal limits about the points, and a margin."""
    reach = 0.57 * np.ptp(points, axis=0).max() * np.array([-1, 1])
    middle = (points.min(0) + points.max(0)) / 2
    axes.set(xlim=middle[0] + reach, ylim=middle[1] + reach, aspect="equal")


def _small_type(face: Face) -> list[tuple[str, str]]:
    """Lines of text, each with its colour."""
    unit = f"Unit: {face.unit} ({SCALE[face.unit]})."
    residual = f"{100 * face.pose.residual:.1f} %"
    pose = (
        f"Head pose: {face.angles.replace('-', '−')} (positive: turned to the subject's "
        "left, looking up, leaning to the subject's right). In the photo, dots are landmarks as "
        "found, lines the shape. "
        f"Turned so, the shape lies {residual} of the face's size from the landmarks (RMS)."
    )
    axes = "Axes: x to the subject's left, y up, z out of the face."
    given = f"{len(face.shape)} landmarks ({face.scheme}) of {_short(face.source.name)}."
    texts = [
        (f"{given} {axes} {unit}", _INK),
        (pose, _INK),
        *((note, _WARNING) for note in face.notes),
    ]
    return [(line, ink) for text, ink in texts for line in textwrap.wrap(_printable(text), _LINE)]


def _short(name: str, length: int = _TITLE_LENGTH) -> str:
    """A name that fits: the middle of a long one is left out, since files differ at their ends."""
    name = _printable(name)
    if len(name) <= length:
        return name
    return f"{name[: length // 2 - 1]}…{name[-length // 2 :]}"


def _printable(text: str) -> str:
    """Text with question marks for what the font has no letter for, instead of warnings."""
    known = get_font(findfont(FontProperties(family=_RC["font.family"]))).get_charmap()
    return "".join(letter if ord(letter) in known else "?" for letter in text)
