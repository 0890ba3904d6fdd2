"""The part of a photo about a face, small enough to be shown beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL import Image

_SIDE = 800  # pixels of the larger side at most
_REACH = 1.05  # from the middle of the landmarks, in larger sides of their box; shows the head


@dataclass(frozen=True, eq=False)
class Cutout:
    """Part of a photo.

    Attributes:
        image: `(H, W, 3)` uint8, RGB.
        landmarks: `(L, 2)` in its pixels, x right, y down.
        first: `(2,)` pixel of the photo at which it begins.
        scale: `(2,)` of its pixels for one of the photo, along x and y.
    """

    image: np.ndarray
    landmarks: np.ndarray
    first: np.ndarray
    scale: np.ndarray

    def place(self, points: np.ndarray) -> np.ndarray:
        """Points of the photo in the pixels of the part: `(..., 2)`."""
        return (points - self.first) * self.scale


def cut_out(photo: np.ndarray, landmarks: np.ndarray, *, side: int = _SIDE) -> Cutout:
    """The square about a face, as far as the photo has it; all of the photo if it has none of it.

    Args:
        photo: `(H, W, 3)` uint8, RGB.
        landmarks: `(L, 2)` pixels of the photo, x right, y down.
        side: Larger side of the result at most, in pixels; nothing is enlarged.
    """
    low, high = landmarks.min(0), landmarks.max(0)
    reach = _REACH * (high - low).max()
    size = np.array(photo.shape[1::-1])
    first = np.clip(np.floor((low + high) / 2 - reach), 0, size).astype(int)
    last = np.clip(np.ceil((low + high) / 2 + reach), 0, size).astype(int)
    if (last <= first).any():
        first, last = np.zeros(2, int), size
    image = Image.fromarray(photo[first[1] : last[1], first[0] : last[0]])
    scale = min(1, side / max(image.size))
    small = tuple(max(1, round(scale * length)) for length in image.size)
    image = image.resize(small, Image.Resampling.LANCZOS, reducing_gap=3)
    scales = np.divide(small, last - first)
    return Cutout(np.asarray(image), (landmarks - first) * scales, first, scales)
