"""Pictures of faces: the photo with the landmarks, and the shape from another side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from deepmds_keras.geometry.views import about_axis
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.tool.predict.faces import Face

_SIDE, _LEAST = 1200, 600  # largest side of the photo in a picture, pixels; smaller is enlarged
_REACH = 1.05  # from the middle of the landmarks, relative to their box; shows the head
_TILE, _COLUMNS = 300, 3  # of faces without a photo, pixels
_MARGIN = 0.1  # of a tile
_YAW, _PITCH = np.radians([[-40], [10]])  # of the view in 3D, as the page begins with one
_SIDEWAYS = (about_axis(0, -_PITCH) @ about_axis(1, _YAW))[0, :2]
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


def cut_out(photo: np.ndarray, landmarks: np.ndarray, *, side: int = 800, least: int = 0) -> Cutout:
    """The square around landmarks, clipped to the photo; the whole photo if it lies outside.

    Args:
        photo: `(H, W, 3)` uint8, RGB.
        landmarks: `(L, 2)` pixels of the photo, x right, y down.
        side: Largest side of the result in pixels; a larger part is reduced.
        least: Largest side to which a smaller part is enlarged.
    """
    low, high = landmarks.min(0), landmarks.max(0)
    reach = _REACH * (high - low).max()
    size = np.array(photo.shape[1::-1])
    first = np.clip(np.floor((low + high) / 2 - reach), 0, size).astype(int)
    last = np.clip(np.ceil((low + high) / 2 + reach), 0, size).astype(int)
    if (last <= first).any():
        first, last = np.zeros(2, int), size
    image = Image.fromarray(photo[first[1] : last[1], first[0] : last[0]])
    longest = max(image.size)
    scale = min(max(longest, least), side) / longest
    width, height = (max(1, round(scale * length)) for length in image.size)
    image = image.resize((width, height), Image.Resampling.LANCZOS, reducing_gap=3)
    return Cutout(image, first, np.divide((width, height), last - first))


def overlay(faces: Sequence[Face], photo: np.ndarray | None) -> Image.Image:
    """Draw the faces as the photo shows them, and beside it their shapes from another side.

    Landmarks are dots, the 3D shape is lines.

    Args:
        faces: One or more of one source, in the pixels of the photo.
        photo: `(H, W, 3)` uint8, RGB, or None: each face is drawn beside its view in 3D.
    """
    return _in_tiles(faces) if photo is None else _on_photo(faces, photo)


def _in_tiles(faces: Sequence[Face]) -> Image.Image:
    columns = min(_COLUMNS, len(faces))
    rows = -(-len(faces) // columns)
    picture = Image.new("RGB", (2 * columns * _TILE, rows * _TILE), "white")
    for i, face in enumerate(faces):
        corner = np.array([2 * (i % columns), i // columns]) * _TILE
        _draw_tile(picture, corner, _TILE, face, face.seen_shape, face.landmarks, face.name)
        _draw_sideways(picture, corner + (_TILE, 0), _TILE, face, "")
    return picture


def _on_photo(faces: Sequence[Face], photo: np.ndarray) -> Image.Image:
    points = np.concatenate([face.landmarks_3d[:, :2] for face in faces])
    cutout = cut_out(photo, points, side=_SIDE, least=_LEAST)
    width, height = cutout.image.size
    if wide := width > 2 * height:  # then below it
        columns = min(len(faces), 2 * _COLUMNS)
        rows, tile = -(-len(faces) // columns), min(width // columns, _TILE)
    else:
        rows = round(np.ceil(np.sqrt(len(faces))))
        columns, tile = -(-len(faces) // rows), height // rows
    size = (width, height + rows * tile) if wide else (width + columns * tile, height)
    picture = Image.new("RGB", size, "white")
    for i, face in enumerate(faces):
        label = str(i + 1) if len(faces) > 1 else ""
        shape, dots = cutout.place(face.seen_shape), cutout.place(face.landmarks)
        _draw(cutout.image, face, shape, dots, label)
        first = np.array([0, height] if wide else [width, 0])
        corner = first + tile * np.array([i % columns, i // columns])
        _draw_sideways(picture, corner, tile, face, label)
    picture.paste(cutout.image)
    return picture


def _draw_sideways(
    picture: Image.Image, corner: np.ndarray, tile: int, face: Face, label: str
) -> None:
    """Draw the shape, turned from the front, into a square of the picture."""
    points = face.xyz @ _SIDEWAYS.T * (1, -1)
    _draw_tile(picture, corner, tile, face, points, points, label)


def _draw_tile(
    picture: Image.Image,
    corner: np.ndarray,
    tile: int,
    face: Face,
    shape: np.ndarray,
    dots: np.ndarray,
    label: str,
) -> None:
    """Draw points `(L, 2)`, y down, into a square of the picture, which they fill."""
    points = np.concatenate([shape, dots])
    low, extent = np.nanmin(points, axis=0), np.ptp(points[~np.isnan(points).any(1)], axis=0)
    scale = (1 - 2 * _MARGIN) * tile / extent.max()
    first = corner + (tile - scale * extent) / 2
    _draw(picture, face, scale * (shape - low) + first, scale * (dots - low) + first, label)


def _draw(image: Image.Image, face: Face, shape: np.ndarray, dots: np.ndarray, label: str) -> None:
    draw = ImageDraw.Draw(image)
    side = np.ptp(shape, axis=0).max()
    radius, width = max(1.0, side / 120), max(1, round(side / 140))
    for line in load_scheme(face.scheme).polylines:
        draw.line([*map(tuple, shape[list(line)])], fill=_LINE, width=width)
    for x, y in dots[~np.isnan(dots).any(1)]:
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), _DOT, _EDGE, width=1)
    corner = shape[:, 0].min(), shape[:, 1].min()
    # Pillow's font has Latin letters only.
    text = "".join(letter if " " <= letter <= "ÿ" else "?" for letter in label[-30:])
    font = ImageFont.load_default(max(12, side / 16))
    draw.text(corner, text, _EDGE, font, "lb", stroke_width=1, stroke_fill="white")
