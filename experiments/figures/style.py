"""One look for every figure: type sizes, a fixed colour and marker a method, and the writer."""

from __future__ import annotations

import functools
import io
from collections.abc import Callable
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure
from PIL import Image

from deepmds_keras.io.atomic import write_bytes
from experiments.methods import METHODS
from experiments.presets import PRESETS

RC = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same on every machine
    "font.size": 7.5,
    "axes.titlesize": 8,
    "axes.labelsize": 7.5,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": "#E3E3E3",
    "grid.linewidth": 0.5,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "lines.linewidth": 1.2,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "pdf.fonttype": 42,  # TrueType: text stays text in the report's PDF
}

TRUTH_COLOUR = "#B4B4B4"
INK = "#333333"
PNG_DPI = 160
_LARGEST = 300_000  # bytes of a picture that is committed


def colour(method: str) -> str:
    """Colour of a method id, the same in every figure."""
    return METHODS[method].colour if method in METHODS else INK


def marker(method: str) -> str:
    """Marker of a method id, so that no figure depends on colour alone."""
    return METHODS[method].marker if method in METHODS else "o"


def styled(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    """Decorate a function so that it draws with `RC`, whatever the caller's settings are."""

    @functools.wraps(draw)
    def wrapper(*args, **kwargs):
        with matplotlib.rc_context(RC):
            return draw(*args, **kwargs)

    return wrapper


def save(figure: Figure, folder: str | Path, name: str) -> tuple[Path, Path]:
    """Write `name.png` and `name.pdf`; equal figures give equal bytes.

    Each file appears whole or not at all. The metadata hold no date.

    Args:
        figure: As returned by the functions of this package.
        folder: Made if it is missing. On figures of results of a small preset stands its caution.
        name: File name without its ending.

    Returns:
        The paths of the png and of the pdf.
    """
    folder = Path(folder)
    for caution in {p.caution for p in PRESETS.values() if p.name in folder.parts and p.caution}:
        figure.text(0.5, 0.5, caution, ha="center", va="center", size=12, color="red", alpha=0.6)
    png, pdf = folder / f"{name}.png", folder / f"{name}.pdf"
    with matplotlib.rc_context(RC):
        write_bytes(png, _small_png(figure))
        figure.set_layout_engine("none")  # what is laid out once need not be for the second file
        write_bytes(pdf, _render(figure, "pdf", metadata={"CreationDate": None}))
    return png, pdf


def _render(figure: Figure, kind: str, **options) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format=kind, **options)
    return buffer.getvalue()


def _small_png(figure: Figure) -> bytes:
    # A palette of 256 colours looks the same for line drawings and takes a third of the room.
    full = _render(figure, "png", dpi=PNG_DPI, metadata={"Software": None})
    image = Image.open(io.BytesIO(full)).convert("RGB")
    if not any(axes.images for axes in figure.axes):
        image = image.quantize(256, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        return _encoded(image)
    # Photographs keep their colours, unless among many lines that makes the file large.
    content = _encoded(image)
    if len(content) > _LARGEST:
        content = _encoded(image.quantize(256, method=Image.Quantize.FASTOCTREE))
    return content


def _encoded(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, format="png", optimize=True, dpi=(PNG_DPI, PNG_DPI))
    return buffer.getvalue()
