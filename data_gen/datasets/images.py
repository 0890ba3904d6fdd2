"""Images of the faces of a data set, each as its landmarks are seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_gen.datasets.dataset import Dataset
from data_gen.models.expressions import sample_expressions
from data_gen.models.morphable_model import MorphableModel
from data_gen.rendering.albedo import Albedo
from data_gen.rendering.renderer import (
    MARGIN,
    Frames,
    Renderer,
    sample_lights,
    square_frames,
    stretched_frames,
)
from data_gen.rendering.visibility import part_of, seen_vertices
from data_gen.views.projections import in_camera_frame, project_with_depth

_FACES_AT_A_TIME = 25  # bounds the memory: a face of the Basel model has 53,490 vertices
_LOOKS = 8  # expressions by which the visible part of an expressive model is found


@dataclass(frozen=True, eq=False)
class Scene:
    """Visible part of a model and its colours, with which the faces of a data set are drawn.

    Attributes:
        model: Morphable model of the vertices that can be seen.
        albedo: Colours of those.
        size: Width and height of the images in pixels.
        margin: Of a square image about the landmarks, as for `rendering.square_frames`.
        stretched: Whether images are cut to the head's bounding box, whatever its aspect, as the
            authors' are, instead of to a square about the landmarks.
    """

    model: MorphableModel
    albedo: Albedo
    size: int
    margin: float
    stretched: bool


def make_scene(
    model: MorphableModel,
    scheme: str,
    size: int,
    protocol: str = "paper",
    *,
    margin: float = MARGIN,
    expressive: bool = False,
) -> Scene:
    """The scene for a model.

    Args:
        model: Morphable model with landmarks of the scheme.
        scheme: Landmark scheme by which images are framed.
        size: Width and height of the images in pixels.
        protocol: As for `projections.sample_cameras`; `"released"` stretches the images.
        margin: As for `rendering.square_frames`.
        expressive: Whether faces will take expressions, which show the teeth and the inside of the
            mouth.

    Raises:
        InputError: The libraries that draw are missing, or the model cannot be coloured.
    """
    stretched = protocol == "released"
    looks = sample_expressions(model, _LOOKS, np.random.default_rng(0)) if expressive else None
    vertices = seen_vertices(model, scheme, whole=stretched, margin=margin, expressions=looks)
    albedo = Albedo(model, vertices, open_mouths=expressive)
    return Scene(part_of(model, vertices), albedo, size, margin, stretched)


def render(
    scene: Scene, dataset: Dataset, faces: range, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Images of some faces of a data set, in colours and light of their own.

    Args:
        scene: What to draw them with.
        dataset: Faces of the same morphable model.
        faces: Their numbers.
        rng: Source of colours and light.

    Returns:
        `(n, size, size, 3)` uint8, and the landmarks in them: `(n, L, 2)` float32 pixels, x right
        and y down from the left upper corner.
    """
    renderer = Renderer(scene.model, scene.size)
    images, pixels = [], []
    for start in range(faces.start, faces.stop, _FACES_AT_A_TIME):
        rows = slice(start, min(start + _FACES_AT_A_TIME, faces.stop))
        cameras = dataset.cameras[rows]
        expression = dataset.expression[rows] if dataset.expression.shape[1] else None
        shapes = scene.model.shape(dataset.identity[rows], expression)
        posed = in_camera_frame(shapes, cameras)
        landmarks = in_camera_frame(dataset.landmarks[rows].astype(float), cameras)
        seen = project_with_depth(posed, landmarks, cameras)
        views = dataset.views[rows].astype(float)
        frames = frames_of(scene, views, seen)
        n = len(cameras)
        albedo, lights = scene.albedo.sample(n, rng), sample_lights(n, rng)
        images.append(renderer.draw(seen, posed, albedo, frames, lights))
        pixels.append(np.float32(frames.pixels(views)))
    renderer.close()
    return np.concatenate(images), np.concatenate(pixels)


def frames_of(scene: Scene, views: np.ndarray, seen: np.ndarray) -> Frames:
    """Part of the views that the images show.

    Args:
        scene: Says how images are cut.
        views: `(n, L, 2)` landmarks, millimetres.
        seen: `(n, V, 3)` vertices, millimetres.
    """
    if scene.stretched:
        return stretched_frames(seen[..., :2], scene.size)
    return square_frames(views, scene.size, scene.margin)
