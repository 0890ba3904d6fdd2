"""One look for all figures, with a fixed colour and marker per method, and the writer."""

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
from experiments.methods import method_of

# Decorates a function to draw in this style, whatever the settings of its caller.
styled = matplotlib.style.context(Path(__file__).with_name("figures.mplstyle"))

TRUTH_COLOUR = "#AAAAAA"
INK = "#333333"
DETECTED_COLOUR = "#FFD000"  # landmarks detected in a photo
_DPI = 160
_LARGEST = 300_000  # bytes of a picture that is committed
_WIDTH = 500  # points across a legend


class Look(NamedTuple):
    """How a method is drawn and what the legend calls it."""

    title: str
    colour: str
    marker: str
    dashes: str | tuple = "-"


def look(method: str, looks: Mapping[str, Look] = {}) -> Look:
    """Look of a method id, the same in every figure; `looks` has ids that are not of the tables.

    Raises:
        InputError: The id is in neither.
    """
    if method in looks:
        return looks[method]
    row = method_of(method)
    return Look(row.title, row.colour, row.marker, row.dashes)


def method_legend(
    figure: Figure,
    methods: Iterable[str],
    more: Sequence[Artist] = (),
    looks: Mapping[str, Look] = {},
    joined: bool = True,
) -> None:
    """Add a legend of method ids below the panels of a figure with a constrained layout.

    Args:
        more: Handles of further entries.
        looks: As for `look`.
        joined: Whether lines join the markers.
    """
    shown = [look(method, looks) for method in methods]
    handles = [Line2D([], [], **drawn(each, joined), label=each.title) for each in shown]
    handles += more
    # A letter is less than four points wide, the handle and the gap to the next column forty.
    widest = max(len(handle.get_label()) for handle in handles)
    columns = max(1, min(4, _WIDTH // int(40 + 3.7 * widest)))
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, columnspacing=1.2)


def drawn(look: Look, joined: bool = True) -> dict:
    """Options of a line with markers, whose white edges part them from bars and each other."""
    marks = {"marker": look.marker, "ms": 4.5, "mec": "white", "mew": 0.4}
    dashes = look.dashes if joined or not look.marker else ""
    return {"color": look.colour, "ls": dashes, "lw": 0.9, **marks}


@styled
def save(figure: Figure, folder: str | Path, name: str, caution: str = "") -> None:
    """Write `name.png` and `name.pdf`; equal figures give equal bytes.

    Each file appears whole or not at all. The metadata hold no date.

    Args:
        folder: Created if it is missing.
        caution: Written beside the figure, `run.preset.caution`: too small a run means nothing.
    """
    size = {}
    if caution:
        figure.text(1, 0.5, caution, rotation=90, ha="left", va="center", size=12, color="red")
        size = {"bbox_inches": "tight"}
    write_bytes(Path(folder) / f"{name}.png", _small_png(figure, **size))
    figure.set_layout_engine("none")  # the second file reuses the layout of the first
    buffer = io.BytesIO()
    figure.savefig(buffer, format="pdf", metadata={"CreationDate": None}, **size)
    write_bytes(Path(folder) / f"{name}.pdf", buffer.getvalue())


def _small_png(figure: Figure, **size: str) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI, **size)
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
