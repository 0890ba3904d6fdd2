"""What a camera makes of a picture."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter


def photograph(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Image as a camera takes it: exposure, colour cast, a little blur, noise, and JPEG.

    Args:
        image: `(H, W, 3)` sRGB in [0, 1].
        rng: Source of all that.

    Returns:
        `(H, W, 3)` uint8.
    """
    light = np.float32(image) ** 2.2
    light *= np.float32(np.exp(rng.normal(0.05, 0.15) + rng.normal(0, (0.06, 0.02, 0.06))))
    photo = light.clip(0, 1) ** (1 / 2.2)
    blur = rng.uniform(0, 0.8)
    photo = gaussian_filter(photo, (blur, blur, 0))
    photo += 0.025 * rng.random() ** 2 * rng.standard_normal(photo.shape, np.float32)
    file = io.BytesIO()
    Image.fromarray(np.uint8(np.rint(255 * photo.clip(0, 1)))).save(
        file, "JPEG", quality=int(rng.integers(70, 96))
    )
    return np.asarray(Image.open(file))
