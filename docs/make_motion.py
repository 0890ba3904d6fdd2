"""Draw the README's moving picture: a photo, its landmarks in 3D, and the head through them.

Run from the repository: `python -m docs.make_motion`, or `make pictures`.
"""

import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from data_gen.models.mesh import vertex_normals
from data_gen.renderer import Rasteriser
from deepmds_keras import predict_photo
from deepmds_keras.files import write_bytes
from deepmds_keras.geometry.views import about_axis
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.tool.command.overlay import cut_out
from deepmds_keras.tool.predict.faces import Face
from deepmds_keras.tool.predict.mesh import fit_surfaces, surface_triangles

_PICTURES = Path(__file__).parent / "pictures"
_SIDE, _FINE = 300, 2  # pixels of a panel; it is drawn so many times as large
_PIXELS = _SIDE * _FINE
_FRAMES, _MILLISECONDS = 40, 80
_TURN = 50.0  # degrees to either side
_COLOURS = 96  # of the palette
_LINE, _DOT = "#D55E00", "#0072B2"  # Okabe and Ito's vermilion and blue
_LAMP = np.array([0.3, 0.4, 0.87])


def moving_picture(photo: Path) -> bytes:
    """One face: the photo with its landmarks, beside them its shape and head, turning. A GIF."""
    (face,) = predict_photo(photo)
    still = _photo(photo, face)
    frames = []
    for turned, head in _turning(face):
        frame = Image.new("RGB", (3 * _SIDE, _SIDE), "white")
        for i, panel in enumerate((still, turned, head)):
            frame.paste(panel.resize((_SIDE, _SIDE), Image.Resampling.LANCZOS), (i * _SIDE, 0))
        frames.append(frame)
    # One palette for all frames, or colours of the photo would flicker.
    palette = frames[0].quantize(_COLOURS, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    frames = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    content = io.BytesIO()
    options = {"save_all": True, "append_images": frames[1:], "loop": 0, "optimize": True}
    frames[0].save(content, format="gif", duration=_MILLISECONDS, **options)
    return content.getvalue()


def _photo(photo: Path, face: Face) -> Image.Image:
    pixels = np.asarray(Image.open(photo).convert("RGB"))
    cutout = cut_out(pixels, face.landmarks, side=_PIXELS, least=_PIXELS)
    _draw(cutout.image, cutout.place(face.landmarks), face.scheme)
    return cutout.image


def _turning(face: Face) -> Iterator[tuple[Image.Image, Image.Image]]:
    """The landmarks and the head of each frame."""
    head, triangles = fit_surfaces(face.xyz[None], face.scheme)[0], surface_triangles()
    head, points = _fill(head.astype(float), 0.87), _fill(face.xyz, 0.65)
    rasteriser = Rasteriser(len(head), triangles, _PIXELS)
    angles = _TURN * np.sin(2 * np.pi * np.arange(_FRAMES) / _FRAMES)
    for turn in about_axis(1, np.radians(angles)):
        wires = Image.new("RGB", (_PIXELS, _PIXELS), "white")
        _draw(wires, _places(points @ turn.T), face.scheme)
        posed = head @ turn.T
        light = 0.35 + 0.65 * (vertex_normals(posed, triangles) @ _LAMP).clip(0)
        grey = np.repeat(np.uint8(235 * light)[:, None], 3, axis=1)
        image = rasteriser.draw(_places(posed), posed[:, 2], grey)
        yield wires, Image.fromarray(image[..., :3].copy())
    rasteriser.close()


def _fill(points: np.ndarray, part: float) -> np.ndarray:
    """Points about their middle, as large as a part of a panel."""
    low, high = points.min(0), points.max(0)
    return (points - (low + high) / 2) * (part * _PIXELS / (high - low).max())


def _places(points: np.ndarray) -> np.ndarray:
    """Pixels of points about the middle of a panel, y up."""
    return _PIXELS / 2 + points[:, :2] * (1, -1)


def _draw(image: Image.Image, points: np.ndarray, scheme: str) -> None:
    """The landmarks `(L, 2)`, in pixels, and the lines of their scheme."""
    draw = ImageDraw.Draw(image)
    for line in load_scheme(scheme).polylines:
        draw.line([*map(tuple, points[list(line)])], _LINE, width=2 * _FINE, joint="curve")
    for point in points:
        draw.circle(tuple(point), 2 * _FINE, _DOT)


def main() -> None:
    """Write it."""
    path = _PICTURES / "astronaut.gif"
    write_bytes(path, moving_picture(_PICTURES / "astronaut.jpg"))
    print(path)


if __name__ == "__main__":
    main()
