"""Image files of data sets, which may be damaged."""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from deepmds_keras.errors import brief


def read_image(path: Path, formats: Sequence[str]) -> np.ndarray:
    """An image, `(H, W, 3)` uint8 RGB.

    Args:
        path: The file.
        formats: Names that Pillow has for those that it may be of.

    Raises:
        ValueError: It is gone, damaged, of another format, or large enough for Pillow to suspect
            an attack, 90 million pixels; the message tells what, on one short line.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            # From memory, where what is claimed to follow is not allotted before it is read.
            content = io.BytesIO(path.read_bytes())
            with Image.open(content, formats=formats) as opened:
                return np.array(opened.convert("RGB"))
    except Exception as error:  # Pillow raises many kinds for a damaged file
        raise ValueError(f"{type(error).__name__}: {brief(error)}") from None
