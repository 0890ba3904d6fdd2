"""An open stand-in for CelebA: photos of faces anywhere, in its aligned form, with known truth.

CelebA (Liu et al. 2015, doi:10.1109/ICCV.2015.425) is free for research only and has no 3D truth.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from data_gen.models.morphable_model import MorphableModel
from data_gen.rendering.albedo import Albedo
from data_gen.rendering.backgrounds import (
    clothes_depth,
    draw_background,
    draw_strands,
    hair_depth,
    lay,
    paint,
)
from data_gen.rendering.photograph import photograph
from data_gen.rendering.renderer import Frames, Renderer, sample_lights
from data_gen.rendering.visibility import part_of, seen_vertices
from data_gen.views.projections import Cameras, in_camera_frame, project_with_depth
from deepmds_keras.errors import InputError

WIDTH, HEIGHT = 178, 218  # of CelebA's aligned images
SCHEME = "bfm72"
_SCHEMES = (SCHEME, "ibug68")
# Of the landmarks bfm72; corners of the eyes, the subject's right eye first.
_EYE_CORNERS, _NOSE_TIP, _CHIN = [[0, 11], [45, 56]], 28, 70
_ALL = "all"  # vertices that can be seen
_BESIDE = (HEIGHT - WIDTH) // 2  # columns cut off from the square that is drawn
_RIM_MM, _CROWN_MM = 4.0, 30.0  # how far up from the lower end of a model, and down from its top
_COLLAR, _NECK = (12.0, 24.0), 0.72  # pixels below the chin; width, in widths of the head
_CLOTHES = ("studio", "clutter", "slats", "banner")
_LONG_HAIR = 0.5  # share, of those who have hair at all
_BALD, _SHADE = 0.1, 0.5  # hair as bright as skin is none; the back of a collar
# CelebA's images were turned, scaled and shifted by the places of the two eyes, set by hand.
_EYES_AT, _EYES_APART = (89.0, 111.5), 38.0  # pixels
_EYES_AT_SD, _EYES_APART_SD = 1.5, 0.03  # pixels, share
_YAW_SD, _YAW_MOST, _PITCH_SD, _PITCH_MOST, _TILT_SD = 15.0, 45.0, 7.0, 20.0, 2.0  # degrees
# The angle that the landmarks fill from 0.7 to 3 m away.
_FIELD_OF_VIEW = (3.0, 13.0)


@dataclass(frozen=True, eq=False)
class Photo:
    """One photo, and the truth about who is on it.

    Attributes:
        name: As of CelebA's files, counted from 1.
        image: `(218, 178, 3)` uint8.
        identity: `(K,)` coefficients of the morphable model.
        landmarks: Scheme to `(L, 3)` landmarks of the neutral face, millimetres, frame of the
            morphable model.
        pixels: Scheme to `(L, 2)`, where these are in the photo, hidden ones too: x right and y
            down, the left upper corner being (0, 0).
        yaw, pitch, roll: Degrees, see `projections`.
    """

    name: str
    image: np.ndarray
    identity: np.ndarray
    landmarks: dict[str, np.ndarray]
    pixels: dict[str, np.ndarray]
    yaw: float
    pitch: float
    roll: float


class PhotosStandin:
    """Neutral faces of standard-normal identity in photos of any light, place and camera.

    A photo depends on the seed and its own number alone, whichever others are made.

    Args:
        model: Morphable model with landmarks `"bfm72"`; those of `"ibug68"` are told too, if known.
        n: Number of photos.
        seed: Of everything random.

    Raises:
        InputError: The model has no such landmarks or cannot be coloured, or the libraries that
            draw are missing.
    """

    def __init__(self, model: MorphableModel, n: int, seed: Sequence[int]):
        if SCHEME not in model.landmarks:
            raise InputError(
                f"{model.name} must have the landmarks {SCHEME} to be photographed. "
                f"Received {', '.join(model.landmarks) or 'none'}."
            )
        self._n, self._seed = n, list(seed)
        self._landmarks = {
            scheme: model.restrict(model.landmarks[scheme])
            for scheme in _SCHEMES
            if scheme in model.landmarks
        }
        seen = seen_vertices(model, SCHEME, whole=True)
        self._model = part_of(model, seen)
        self._albedo = Albedo(model, seen)
        height = self._model.mean[:, 1]
        self._rim = height < height.min() + _RIM_MM
        self._crown = height > height.max() - _CROWN_MM
        self._nose = np.searchsorted(seen, model.landmarks[SCHEME][_NOSE_TIP])

    def __len__(self) -> int:
        return self._n

    def photos(self, numbers: range) -> Iterator[Photo]:
        """Some photos, by their numbers from 0, each made when it is asked for."""
        renderer = Renderer(self._model, HEIGHT)
        try:
            for number in numbers:
                yield self._photo(number, renderer)
        finally:
            renderer.close()

    def _photo(self, number: int, renderer: Renderer) -> Photo:
        rng = np.random.default_rng([*self._seed, number])
        identity = rng.standard_normal((1, self._model.n_identity))
        landmarks = {scheme: part.shape(identity) for scheme, part in self._landmarks.items()}
        camera = _draw_camera(landmarks[SCHEME], rng)
        shapes = {**landmarks, _ALL: self._model.shape(identity)}
        posed = {name: in_camera_frame(points, camera) for name, points in shapes.items()}
        seen = {
            name: project_with_depth(points, posed[SCHEME], camera)
            for name, points in posed.items()
        }
        frame = _draw_frame(seen[SCHEME][..., :2], rng)
        places = {name: frame.pixels(points[..., :2])[0] for name, points in seen.items()}
        image = self._drawn(renderer, seen[_ALL], posed[_ALL], frame, places, rng)
        return Photo(
            name=f"{number + 1:06}.jpg",
            image=photograph(image[:, _BESIDE:-_BESIDE], rng),
            identity=identity[0],
            landmarks={scheme: points[0] for scheme, points in landmarks.items()},
            pixels={scheme: places[scheme] - (_BESIDE, 0) for scheme in landmarks},
            yaw=float(camera.yaw[0]),
            pitch=float(camera.pitch[0]),
            roll=float(camera.roll[0]),
        )

    def _drawn(
        self,
        renderer: Renderer,
        seen: np.ndarray,
        posed: np.ndarray,
        frame: Frames,
        places: dict[str, np.ndarray],
        rng: np.random.Generator,
    ) -> np.ndarray:
        """The square picture of the head, its hair and clothes, and what is behind.

        Returns:
            `(HEIGHT, HEIGHT, 3)` in [0, 1].
        """
        albedo, lights = self._albedo.sample(1, rng), sample_lights(1, rng)
        picture = draw_background(HEIGHT, rng)
        clothes = paint(_CLOTHES[rng.integers(len(_CLOTHES))], HEIGHT, rng)
        chin = places[SCHEME][_CHIN]
        head = places[_ALL][places[_ALL][:, 1] < chin[1]]
        low, high = head.min(0), head.max(0)
        hair, skin = albedo[0, self._crown].mean(0), albedo[0, self._nose]
        if rng.random() < _LONG_HAIR and np.abs(hair - skin).max() > _BALD:
            in_the_shade = lights.ambient[0] * lights.colour[0] * hair
            depth = hair_depth(HEIGHT, low, high, rng)
            lay(picture, in_the_shade * draw_strands(HEIGHT, rng), depth)
        # The neckline is to hide where the model ends, but not the chin.
        rim, below = places[_ALL][self._rim], chin[1] + rng.uniform(*_COLLAR)
        height = max(min(below, rim[:, 1].min() - 2), chin[1] + _COLLAR[0] / 2)
        collar, neck = np.array([rim[:, 0].mean(), height]), _NECK * (high[0] - low[0]) / 2
        front, back = clothes_depth(HEIGHT, collar, neck, rng)
        lay(picture, _SHADE * clothes, back)
        behind = np.uint8(np.rint(255 * picture))
        image = renderer.draw(seen, posed, albedo, frame, lights, behind[None])[0] / 255
        lay(image, clothes, front)
        return image


def _draw_camera(landmarks: np.ndarray, rng: np.random.Generator) -> Cameras:
    """A pose in which the line through the eyes is nearly level, `(1, L, 3)` → one camera."""
    yaw = np.clip(rng.normal(0, _YAW_SD, 1), -_YAW_MOST, _YAW_MOST)
    pitch = np.clip(rng.normal(0, _PITCH_SD, 1), -_PITCH_MOST, _PITCH_MOST)
    tilt, angle = rng.normal(0, _TILT_SD, 1), rng.uniform(*_FIELD_OF_VIEW, 1)
    unrolled = Cameras(np.ones(1, int), yaw, pitch, np.zeros(1), angle)
    right, left = in_camera_frame(landmarks, unrolled)[0, _EYE_CORNERS].mean(1)
    x, y = (left - right)[:2]
    return Cameras(np.ones(1, int), yaw, pitch, tilt - np.rad2deg(np.arctan2(y, x)), angle)


def _draw_frame(views: np.ndarray, rng: np.random.Generator) -> Frames:
    """The square whose middle columns are the photo, by the places of the eyes in the view."""
    right, left = views[0, _EYE_CORNERS].mean(1)
    apart = _EYES_APART * np.exp(rng.normal(0, _EYES_APART_SD))
    millimetres = np.linalg.norm(left - right) / apart  # of a pixel
    x, y = _EYES_AT + rng.normal(0, _EYES_AT_SD, 2)
    corner = (x + (HEIGHT - WIDTH) / 2, HEIGHT - y)
    low = (right + left) / 2 - millimetres * np.array(corner)
    return Frames(low[None], np.full((1, 2), millimetres * HEIGHT), HEIGHT)
