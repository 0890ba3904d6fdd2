"""Photos of expressive faces turned any way, with the truth about what they show."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from data_gen.datasets.images import make_scene
from data_gen.models.morphable_model import MorphableModel
from data_gen.rendering.backgrounds import draw_background
from data_gen.rendering.photograph import photograph
from data_gen.rendering.renderer import Frames, Renderer, sample_lights
from data_gen.views.photo_views import sample_expressive
from data_gen.views.projections import (
    in_camera_frame,
    project_with_depth,
    sample_perspective_cameras,
)

SCHEMES = ("ibug68", "bfm72")
_FRAMED = "ibug68"
PIXELS = 320
YAW, PITCH, ROLL = 60.0, 25.0, 25.0  # uniform, to either side, degrees
_FIELD_OF_VIEW = (3.0, 25.0)
_MARGIN = (
    1.5,
    2.5,
)  # side of a photo, in sizes of the landmarks' box: the face has 130 to 210 pixels
_OFF_CENTRE = 0.3  # of the room beside that box


@dataclass(frozen=True, eq=False)
class Portrait:
    """One photo.

    Attributes:
        image: `(320, 320, 3)` uint8.
        landmarks: Scheme to `(L, 3)` true landmarks, millimetres, frame of the morphable model.
        pixels: Scheme to `(L, 2)`, where these are in the photo, hidden ones too: x right and y
            down, the left upper corner being (0, 0).
        yaw, roll: Degrees, see `projections`.
    """

    image: np.ndarray
    landmarks: dict[str, np.ndarray]
    pixels: dict[str, np.ndarray]
    yaw: float
    roll: float


class Portraits:
    """Faces of standard-normal identity in any expression, pose, light and place.

    A photo depends on the seed and its own number alone, whichever others are made.

    Args:
        model: Morphable model with landmarks of `SCHEMES` and named expressions.
        seed: Of everything random.

    Raises:
        InputError: As `images.make_scene`, or the model's expressions have other names.
    """

    def __init__(self, model: MorphableModel, seed: Sequence[int]):
        self._seed = list(seed)
        self._names = model.restrict(np.empty(0, int))
        self._landmarks = {s: model.restrict(model.landmarks[s]) for s in SCHEMES}
        self._scene = make_scene(model, _FRAMED, PIXELS, margin=_MARGIN[1], expressive=True)

    def photos(self, numbers: range) -> Iterator[Portrait]:
        """Some photos, by their numbers, each made when it is asked for."""
        renderer = Renderer(self._scene.model, PIXELS)
        try:
            for number in numbers:
                yield self._photo(np.random.default_rng([*self._seed, number]), renderer)
        finally:
            renderer.close()

    def _photo(self, rng: np.random.Generator, renderer: Renderer) -> Portrait:
        identity, expression = sample_expressive(self._names, 1, rng)
        camera = sample_perspective_cameras(
            1, rng, yaw=YAW, pitch=PITCH, roll=ROLL, field_of_view=_FIELD_OF_VIEW
        )
        landmarks = {s: part.shape(identity, expression) for s, part in self._landmarks.items()}
        marked = {s: in_camera_frame(points, camera) for s, points in landmarks.items()}
        posed = in_camera_frame(self._scene.model.shape(identity, expression), camera)
        framed = marked[_FRAMED]
        views = {
            s: project_with_depth(points, framed, camera)[..., :2] for s, points in marked.items()
        }
        seen = project_with_depth(posed, framed, camera)
        frame = _draw_frame(views[_FRAMED], rng)
        albedo, lights = self._scene.albedo.sample(1, rng), sample_lights(1, rng)
        behind = np.uint8(np.rint(255 * draw_background(PIXELS, rng)))
        drawn = renderer.draw(seen, posed, albedo, frame, lights, behind[None])[0]
        return Portrait(
            image=photograph(drawn / 255, rng),
            landmarks={s: points[0] for s, points in landmarks.items()},
            pixels={s: frame.pixels(view)[0] for s, view in views.items()},
            yaw=float(camera.yaw[0]),
            roll=float(camera.roll[0]),
        )


def _draw_frame(views: np.ndarray, rng: np.random.Generator) -> Frames:
    """A square with room about the landmarks, which need not be in its middle."""
    low, high = views.min(1), views.max(1)
    size = (high - low).max()
    side = size * rng.uniform(*_MARGIN)
    off = _OFF_CENTRE * (side - size) * rng.uniform(-1, 1, 2)
    return Frames((low + high - side) / 2 + off, np.full((1, 2), side), PIXELS)
