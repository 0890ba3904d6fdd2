"""HTML pages in a browser."""

from __future__ import annotations

import base64
import io

import numpy as np
from PIL import Image


def drawn(page, which=0):
    """What a canvas shows, `(H, W, 4)`, once what was asked of it is drawn."""
    canvas = page.locator("canvas").nth(which)
    canvas.scroll_into_view_if_needed()
    encoded = canvas.evaluate(
        """async (canvas) => {
          for (let k = 0; k < 4; k += 1) await new Promise(requestAnimationFrame);
          return canvas.toDataURL();
        }"""
    )
    png = io.BytesIO(base64.b64decode(encoded.partition(",")[2]))
    return np.asarray(Image.open(png).convert("RGBA"))
