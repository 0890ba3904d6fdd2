"""Pictures of faces: the photo with the landmarks and the wireframe of the shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from deepmds_keras.files import atomic_write
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.tool.predict.faces import Face

_SIDE = 1200  # largest side of a picture, pixels
_REACH = 1.05  # from the middle of the landmarks, relative to their box; shows the head
_TILE, _MARGIN, _COLUMNS = 300, 30, 6  # of faces without a photo, pixels
_LINE, _DOT, _EDGE = "#FF9448", "#FFD000", "#333333"


@dataclass(frozen=True, eq=False)
class Cutout:
    """Part of a photo.

    Attributes:
        image: RGB.
        first: `(2,)` pixel of the photo, x and y, at which it begins.
        scale: `(2,)` of its pixels for one of the photo, along x and y.
    """

    image: Image.Image
    first: np.ndarray
    scale: np.ndarray

    def place(self, points: np.ndarray) -> np.ndarray:
        """Points of the photo in the pixels of the part: `(..., 2)`."""
        return (points - self.first) * self.scale


def cut_out(photo: np.ndarray, landmarks: np.ndarray, *, side: int = 800) -> Cutout:
    """The square around landmarks, clipped to the photo; the whole photo if it lies outside.

    Args:
        photo: `(H, W, 3)` uint8, RGB.
        landmarks: `(L, 2)` pixels of the photo, x right, y down.
        side: Largest side of the result in pixels; nothing is enlarged.
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
    width, height = (max(1, round(scale * length)) for length in image.size)
    image = image.resize((width, height), Image.Resampling.LANCZOS, reducing_gap=3)
    return Cutout(image, first, np.divide((width, height), last - first))


def overlay(faces: Sequence[Face], photo: np.ndarray | None) -> Image.Image:
    """Draw the faces on their photo, or side by side: landmarks as dots, the 3D shape as lines.

    Args:
        faces: One or more of one source, in the pixels of the photo.
        photo: `(H, W, 3)` uint8, RGB, or None.
    """
    if photo is not None:
        points = np.concatenate([face.landmarks_3d[:, :2] for face in faces])
        cutout = cut_out(photo, points, side=_SIDE)
        for number, face in enumerate(faces, 1):
            _draw(cutout.image, face, cutout, str(number) if len(faces) > 1 else "")
        return cutout.image
    columns = min(_COLUMNS, len(faces))
    size = columns * _TILE, -(-len(faces) // columns) * _TILE
    picture = Image.new("RGB", size, "white")
    for i, face in enumerate(faces):
        points = np.concatenate([face.landmarks_3d[:, :2], face.seen_shape])
        low, extent = points.min(0), np.ptp(points, axis=0)
        scale = (_TILE - 2 * _MARGIN) / extent.max()
        corner = np.array([i % columns, i // columns]) * _TILE + (_TILE - scale * extent) / 2
        _draw(picture, face, Cutout(picture, low - corner / scale, np.full(2, scale)), face.name)
    return picture


def write_overlay(path: Path, faces: Sequence[Face], photo: np.ndarray | None) -> None:
    """Write the picture of `overlay` as PNG, whole or not at all.

    Raises:
        InputError, OSError: As for `atomic_write`.
    """
    with atomic_write(path) as file:
        overlay(faces, photo).save(file, "png")


def _draw(image: Image.Image, face: Face, cutout: Cutout, label: str) -> None:
    draw = ImageDraw.Draw(image)
    shape, dots = cutout.place(face.seen_shape), cutout.place(face.landmarks)
    side = np.ptp(shape, axis=0).max()
    radius, width = max(1.0, side / 120), max(1, round(side / 200))
    for line in load_scheme(face.scheme).polylines:
        draw.line([*map(tuple, shape[list(line)])], fill=_LINE, width=width)
    for x, y in dots[~np.isnan(dots).any(1)]:
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), _DOT, _EDGE, width=1)
    corner = shape[:, 0].min(), shape[:, 1].min()
    # Pillow's font has Latin letters only.
    text = "".join(letter if " " <= letter <= "ÿ" else "?" for letter in label[-30:])
    font = ImageFont.load_default(max(12, side / 16))
    draw.text(corner, text, _EDGE, font, "lb", stroke_width=1, stroke_fill="white")
