"""Figures as small as a page that holds them all needs them."""

from __future__ import annotations

import base64
import io
from pathlib import Path

from PIL import Image

_WIDTH = 1152  # pixels: that of most figures, and a little more than the page is wide
_COLOURS = 128


def data_uri(path: Path) -> tuple[str, tuple[int, int]]:
    """A figure as a data URI of WebP, and its width and height in pixels.

    `figures.style.save` gives drawings a palette. They stay without loss, with fewer colours, for
    lines blur and take more room otherwise; of photos the loss is not seen.
    """
    with Image.open(path) as file:
        drawing, image = file.mode == "P", file.convert("RGB")
    image.thumbnail((_WIDTH, 10 * _WIDTH), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    if drawing:
        image = image.quantize(_COLOURS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        # The octree's white is a little grey.
        image = image.convert("RGB").point(lambda value: 255 if value > 250 else value)
        image.save(buffer, "webp", lossless=True, quality=100)
    else:
        image.save(buffer, "webp", quality=72)
    return f"data:image/webp;base64,{base64.b64encode(buffer.getvalue()).decode()}", image.size
