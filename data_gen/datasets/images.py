"""Images of the faces of a data set, each in the view of its landmarks."""

from dataclasses import dataclass

import numpy as np

from data_gen.appearance import Albedo, sample_lights
from data_gen.datasets.dataset import Dataset
from data_gen.models.expressions import sample_expressions
from data_gen.models.morphable_model import MorphableModel
from data_gen.renderer import MARGIN, Renderer, frames_of, part_of, seen_vertices
from deepmds_keras.geometry.views import pose_and_project

_FACES_AT_A_TIME = 25  # bounds the memory: a face of the Basel model has 53,490 vertices
_LOOKS = 8  # expressions for determining the visible part of an expressive model


@dataclass(frozen=True, eq=False)
class Scene:
    """Visible part of a model and its colours, for rendering the faces of a data set.

    Attributes:
        model: Morphable model of the visible vertices.
        albedo: Colours of those.
        size: Width and height of the images in pixels.
        margin: Of a square image about the landmarks, as for `renderer.square_frames`; None for
            images cut to the head's bounding box, whatever its aspect, like the authors'.
    """

    model: MorphableModel
    albedo: Albedo
    size: int
    margin: float | None


def make_scene(
    model: MorphableModel,
    scheme: str,
    size: int,
    *,
    margin: float | None = MARGIN,
    expressive: bool = False,
) -> Scene:
    """The scene for a model.

    Args:
        model: Morphable model with landmarks of the scheme.
        scheme: Landmark scheme by which images are framed.
        size, margin: As for `Scene`.
        expressive: Whether faces have expressions, which show the teeth and the inside of the
            mouth.

    Raises:
        InputError: The rendering libraries are missing, or the model cannot be coloured.
    """
    looks = sample_expressions(model, _LOOKS, np.random.default_rng(0)) if expressive else None
    vertices = seen_vertices(model, scheme, margin=margin, expressions=looks)
    albedo = Albedo(model, vertices, open_mouths=expressive)
    return Scene(part_of(model, vertices), albedo, size, margin)


def posed_faces(
    model: MorphableModel, dataset: Dataset, rows: slice
) -> tuple[np.ndarray, np.ndarray]:
    """As from `views.pose_and_project`, of the vertices of some faces of a data set."""
    expression = dataset.expression[rows] if dataset.expression.shape[1] else None
    shapes = model.shape(dataset.identity[rows], expression)
    return pose_and_project(shapes, dataset.landmarks[rows].astype(float), dataset.cameras[rows])


def render(
    scene: Scene, dataset: Dataset, faces: range, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Images of some faces of a data set of the scene's model, in random colours and light.

    Returns:
        `(n, size, size, 3)` uint8, and the landmarks in them: `(n, L, 2)` float32 pixels, x right
        and y down from the left upper corner.
    """
    renderer = Renderer(scene.model, scene.size)
    images, pixels = [], []
    for start in range(faces.start, faces.stop, _FACES_AT_A_TIME):
        rows = slice(start, min(start + _FACES_AT_A_TIME, faces.stop))
        posed, seen = posed_faces(scene.model, dataset, rows)
        views = dataset.views[rows].astype(float)
        frames = frames_of(views, seen, scene.size, scene.margin)
        albedo, lights = scene.albedo.sample(len(posed), rng), sample_lights(len(posed), rng)
        images.append(renderer.draw(seen, posed, albedo, frames, lights))
        pixels.append(np.float32(frames.pixels(views)))
    renderer.close()
    return np.concatenate(images), np.concatenate(pixels)
