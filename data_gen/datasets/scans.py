"""One face scan: a photo, points of the surface, and perhaps the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Scan:
    """A photo of a face and a scan of it.

    Attributes:
        name: Unique within its source, such as `"001-004"`.
        condition: What the source says of it, such as the name of an expression; may be empty.
        image: `(H, W, 3)` uint8, RGB.
        points: `(n, 3)` millimetres: +x to the right of the image, +y up, +z towards the viewer.
        truth: `(51, 3)` true landmarks in millimetres, in the frame of the face model, or None
            where nobody knows them.
        pixels: `(51, 2)` where they truly lie in the image, x right and y down, or None.
    """

    name: str
    condition: str
    image: np.ndarray
    points: np.ndarray
    truth: np.ndarray | None = None
    pixels: np.ndarray | None = None
