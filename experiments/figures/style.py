"""One look for all figures, with a fixed colour and marker per method, and the writer."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib.style
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

from deepmds_keras.files import write_bytes
from experiments.methods import METHODS, title

# Decorates a function to draw in this style, whatever the settings of its caller.
styled = matplotlib.style.context(Path(__file__).with_name("figures.mplstyle"))

TRUTH_COLOUR = "#B4B4B4"
INK = "#333333"
DETECTED_COLOUR = "#FFD000"  # landmarks detected in a photo
_DPI = 160
_LARGEST = 300_000  # bytes of a picture that is committed
_BOUND = "lower_bound"  # not a method: a dashed line without markers


class Look(NamedTuple):
    """How a method is drawn and what the legend calls it."""

    title: str
    colour: str
    marker: str
    dashes: str | tuple = "-"


def look(method: str, looks: Mapping[str, Look] = {}) -> Look:
    """Look of a method id, the same in every figure.

    Args:
        method: Its id.
        looks: Looks of ids that are not methods of the tables, such as parts of one.

    Raises:
        InputError: The id is in neither.
    """
    if method in looks:
        return looks[method]
    if method == _BOUND:
        return Look(title(method), colour(method), "", (0, (4, 2)))
    return Look(title(method), colour(method), marker(method))


def colour(method: str) -> str:
    """Colour of a method id, the same in every figure."""
    return METHODS[method].colour if method in METHODS else INK


def marker(method: str) -> str:
    """Marker of a method id, so that no figure depends on colour alone."""
    return METHODS[method].marker if method in METHODS else "o"


def method_legend(
    figure: Figure,
    methods: Iterable[str],
    more: Sequence[Artist] = (),
    looks: Mapping[str, Look] = {},
) -> None:
    """Add a legend of methods below the panels of a figure with a constrained layout.

    Args:
        figure: The figure.
        methods: Ids in the order of the legend.
        more: Handles of further entries.
        looks: As for `look`.
    """
    handles = [
        Line2D([], [], color=ink, marker=shape, ls=dashes, ms=4, mew=0, lw=0.9, label=name)
        for name, ink, shape, dashes in (look(method, looks) for method in methods)
    ]
    place = {"loc": "outside lower center", "ncols": 4, "columnspacing": 1.2}
    figure.legend(handles=[*handles, *more], **place)


@styled
def save(figure: Figure, folder: str | Path, name: str, caution: str = "") -> None:
    """Write `name.png` and `name.pdf`; equal figures give equal bytes.

    Each file appears whole or not at all. The metadata hold no date.

    Args:
        figure: As returned by the functions of this package.
        folder: Created if it is missing.
        name: File name without its ending.
        caution: Written across the figure, `run.preset.caution`: too small a run means nothing.
    """
    if caution:
        figure.text(0.5, 0.5, caution, ha="center", va="center", size=12, color="red", alpha=0.6)
    write_bytes(Path(folder) / f"{name}.png", _small_png(figure))
    figure.set_layout_engine("none")  # the second file reuses the layout of the first
    buffer = io.BytesIO()
    figure.savefig(buffer, format="pdf", metadata={"CreationDate": None})
    write_bytes(Path(folder) / f"{name}.pdf", buffer.getvalue())


def _small_png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI)
    image = Image.open(buffer).convert("RGB")
    if not any(axes.images for axes in figure.axes):
        # A palette of 256 colours looks the same for line drawings and takes a third of the space.
        palette = {"method": Image.Quantize.MAXCOVERAGE, "dither": Image.Dither.NONE}
        return _encoded(image.quantize(256, **palette))
    # Photographs keep their colours, unless among many lines that makes the file large.
    content = _encoded(image)
    if len(content) <= _LARGEST:
        return content
    return _encoded(image.quantize(256, method=Image.Quantize.FASTOCTREE))


def _encoded(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, format="png", optimize=True, dpi=(_DPI, _DPI))
    return buffer.getvalue()
