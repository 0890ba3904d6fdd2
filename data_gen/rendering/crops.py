"""Squares about the landmarks, cut from photos of any size."""

from __future__ import annotations

import numpy as np
from PIL import Image


def crop(
    image: np.ndarray, landmarks: np.ndarray, size: int, margin: float
) -> tuple[np.ndarray, np.ndarray]:
    """The square about the landmarks of a face, as `rendering.square_frames` has it.

    What lies beyond the photo repeats its edge.

    Args:
        image: `(H, W, 3)` uint8.
        landmarks: `(L, 2)` pixels, x right and y down from the left upper corner.
        size: Pixels of a side of what is returned.
        margin: Side of the square, in sizes of the landmarks' box.

    Returns:
        `(size, size, 3)` uint8, and the landmarks in it, `(L, 2)`.
    """
    low, high = landmarks.min(0), landmarks.max(0)
    side = margin * (high - low).max()
    corner = (low + high - side) / 2
    beyond = np.ceil(np.maximum([-corner, corner + side - image.shape[1::-1]], 0)).astype(int)
    (left, top), (right, bottom) = beyond
    wide = Image.fromarray(np.pad(image, ((top, bottom), (left, right), (0, 0)), mode="edge"))
    x, y = corner + (left, top)
    square = wide.resize((size, size), Image.Resampling.BICUBIC, (x, y, x + side, y + side))
    return np.asarray(square), (landmarks - corner) * (size / side)
