"""Images of faces: what part of the view they show, the light, and the colours under it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_gen.models.mesh import triangle_corners, vertex_normals
from data_gen.models.morphable_model import MorphableModel
from data_gen.rendering.rasteriser import BACKGROUND, Rasteriser

MARGIN = 1.4  # side of a square image, in sizes of the landmarks' box
_OVERSAMPLING = 2  # pixels are means of so many by so many


@dataclass(frozen=True, eq=False)
class Frames:
    """Part of the plane of the view that each of `n` images shows.

    Attributes:
        low: `(n, 2)` millimetres, the left lower corner, y up.
        extent: `(n, 2)` millimetres, width and height.
        size: Width and height in pixels.
    """

    low: np.ndarray
    extent: np.ndarray
    size: int

    def pixels(self, views: np.ndarray) -> np.ndarray:
        """Where points of the views appear: `(n, L, 2)` → `(n, L, 2)`, x right and y down.

        The left upper corner of the image is (0, 0), the middle of its first pixel (0.5, 0.5).
        """
        inside = (views - self.low[:, None]) / self.extent[:, None]
        inside[..., 1] = 1 - inside[..., 1]
        return inside * self.size


def square_frames(views: np.ndarray, size: int, margin: float = MARGIN) -> Frames:
    """Squares about the landmarks, as a face detector would cut them out.

    Args:
        views: `(n, L, 2)` landmarks, millimetres.
        size: Pixels of a side.
        margin: Side of the square, in sizes of the landmarks' box.
    """
    low, high = views.min(1), views.max(1)
    side = margin * (high - low).max(1, keepdims=True)
    return Frames((low + high - side) / 2, np.repeat(side, 2, axis=1), size)


def stretched_frames(views: np.ndarray, size: int) -> Frames:
    """The bounding boxes of the points, stretched to squares, as the authors' images are.

    Args:
        views: `(n, V, 2)` all that is seen, millimetres.
        size: Pixels of a side.
    """
    low, high = views.min(1), views.max(1)
    return Frames(low, high - low, size)


@dataclass(frozen=True, eq=False)
class Lights:
    """Light on each of `n` faces: ambient, and one far lamp.

    Attributes:
        direction: `(n, 3)` unit vectors to the lamp in the camera's frame.
        ambient: `(n,)` share of the albedo that is seen without the lamp.
        colour: `(n, 3)` of all light, what a white surface towards the lamp sends back.
    """

    direction: np.ndarray
    ambient: np.ndarray
    colour: np.ndarray


def sample_lights(n: int, rng: np.random.Generator) -> Lights:
    """Lamps up to 60 degrees aside of the camera and from 10 below it to 60 above."""
    aside, above = np.deg2rad(rng.uniform(-60, 60, n)), np.deg2rad(rng.uniform(-10, 60, n))
    direction = np.stack(
        [np.sin(aside) * np.cos(above), np.sin(above), np.cos(aside) * np.cos(above)], axis=1
    )
    return Lights(
        direction=direction,
        ambient=rng.uniform(0.35, 0.65, n),
        colour=rng.uniform(0.8, 1.15, (n, 1)) * rng.normal(1, 0.015, (n, 3)),
    )


class Renderer:
    """Draws lit faces of one morphable model.

    Args:
        model: Morphable model, for its triangles.
        size: Width and height of the images in pixels.

    Raises:
        InputError: The system library that draws is missing.
    """

    def __init__(self, model: MorphableModel, size: int):
        self.size = size
        self._triangles = model.triangles
        self._corners = triangle_corners(model.n_vertices, model.triangles)
        self._rasteriser = Rasteriser(model.n_vertices, model.triangles, size * _OVERSAMPLING)

    def draw(
        self,
        vertices: np.ndarray,
        posed: np.ndarray,
        albedo: np.ndarray,
        frames: Frames,
        lights: Lights,
        backgrounds: np.ndarray | None = None,
    ) -> np.ndarray:
        """Images of faces.

        Args:
            vertices: `(n, V, 3)` as from `projections.project_with_depth`.
            posed: `(n, V, 3)` as from `projections.in_camera_frame`, for the light.
            albedo: `(n, V, 3)` sRGB in [0, 1].
            frames: What part of the view each image shows.
            lights: On each face.
            backgrounds: `(n, size, size, 3)` uint8, what is seen behind the faces, white by
                default.

        Returns:
            `(n, size, size, 3)` uint8.
        """
        images = np.empty((len(vertices), self.size, self.size, 3), np.uint8)
        places = frames.pixels(vertices[..., :2]) * _OVERSAMPLING
        for i, image in enumerate(images):
            normals = vertex_normals(posed[i], self._triangles, self._corners)
            lamp = (normals @ lights.direction[i]).clip(0)
            light = lights.ambient[i] + (1 - lights.ambient[i]) * lamp
            colours = (albedo[i] * light[:, None] * lights.colour[i]).clip(0, 1)
            colours = np.uint8(np.rint(255 * colours))
            wide = self._rasteriser.draw_cut_out(places[i], vertices[i, :, 2], colours)
            means = _means_of_cells(wide)
            drawn = means[..., :3]
            if backgrounds is not None:
                share_behind = 1 - means[..., 3:] / 255
                drawn = drawn + share_behind * (backgrounds[i] - float(BACKGROUND))
            image[:] = np.rint(drawn)
        return images

    def close(self) -> None:
        self._rasteriser.close()


def _means_of_cells(wide: np.ndarray) -> np.ndarray:
    """Means of squares of pixels, exact: as `mean` over reshaped axes, and many times as fast."""
    starts = range(_OVERSAMPLING)
    sums = sum(np.uint16(wide[i::_OVERSAMPLING, j::_OVERSAMPLING]) for i in starts for j in starts)
    return sums / _OVERSAMPLING**2
