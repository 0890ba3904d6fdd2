"""Photos of synthetic faces with the truth about who is on them.

`PhotosSubstitute` is in place of CelebA (Liu et al. 2015, doi:10.1109/ICCV.2015.425), which is free
for research only and has no 3D truth; `Portraits` are of expressive faces turned any way.
"""

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from data_gen.appearance import sample_lights
from data_gen.datasets.images import Scene, make_scene
from data_gen.models.morphable_model import MorphableModel
from data_gen.photographs import (
    clothes_depth,
    composite,
    draw_background,
    draw_strands,
    hair_depth,
    paint,
    photograph,
)
from data_gen.renderer import Frames, Renderer
from data_gen.views import sample_expressive
from deepmds_keras.geometry.views import (
    Cameras,
    in_camera_frame,
    pose_and_project,
    sample_perspective_cameras,
)

WIDTH, HEIGHT = 178, 218  # of CelebA's aligned images
SCHEME = "bfm72"
_SCHEMES = (SCHEME, "ibug68")
# Of the landmarks bfm72; corners of the eyes, the subject's right eye first.
_EYE_CORNERS, _NOSE_TIP, _CHIN = [[0, 11], [45, 56]], 28, 70
_BESIDE = (HEIGHT - WIDTH) // 2  # columns cut off from the square that is drawn
_RIM_MM, _CROWN_MM = 4.0, 30.0  # how far up from the lower end of a model, and down from its top
_COLLAR, _NECK = (12.0, 24.0), 0.72  # pixels below the chin; width, in widths of the head
_CLOTHES = ("studio", "clutter", "slats", "banner")
_LONG_HAIR = 0.5  # share, of those who have hair at all
_BALD, _SHADE = 0.1, 0.5  # hair as bright as skin is none; the back of a collar
# CelebA's images were turned, scaled and shifted by the places of the two eyes, set by hand.
_EYES_AT, _EYES_APART = (89.0, 111.5), 38.0  # pixels
_EYES_AT_SD, _EYES_APART_SD = 1.5, 0.03  # pixels, share
_YAW_SD, _MAX_YAW, _PITCH_SD, _MAX_PITCH, _TILT_SD = 15.0, 45.0, 7.0, 20.0, 2.0  # degrees
# The angle that the landmarks fill from 0.7 to 3 m away.
_FIELD_OF_VIEW = (3.0, 13.0)
# Of portraits.
PIXELS = 320
_FRAMED = "ibug68"
YAW, PITCH, ROLL = 60.0, 25.0, 25.0  # uniform, to either side, degrees
_PORTRAIT_FIELD_OF_VIEW = (3.0, 25.0)
_MARGIN = (1.5, 2.5)  # side of a photo, in sizes of the landmarks' box: faces of 130 to 210 pixels
_OFF_CENTRE = 0.3  # of the margin around that box


@dataclass(frozen=True, eq=False)
class Photo:
    """One photo, and the truth about who is on it.

    Attributes:
        name: As of CelebA's files, counted from 1.
        image: `(H, W, 3)` uint8.
        landmarks: Scheme to `(L, 3)` landmarks of the face, millimetres, frame of the morphable
            model.
        pixels: Scheme to `(L, 2)`, where these are in the photo, hidden ones too: x right and y
            down, the left upper corner being (0, 0).
        yaw: Degrees, see `views`.
    """

    name: str
    image: np.ndarray
    landmarks: dict[str, np.ndarray]
    pixels: dict[str, np.ndarray]
    yaw: float


class Portraits:
    """Faces of standard-normal identity in any expression, pose, light and place, 320 pixels wide.

    A photo depends on the seed and its number alone, whichever others are drawn.

    Args:
        model: Morphable model with landmarks `"bfm72"` and `"ibug68"` and named expressions.

    Raises:
        InputError: As `images.make_scene`, or the model's expressions have other names.
    """

    _framed = _FRAMED

    def __init__(self, model: MorphableModel, seed: Sequence[int]):
        scene = make_scene(model, _FRAMED, PIXELS, margin=_MARGIN[1], expressive=True)
        self._set_up(model, seed, scene)

    def _set_up(self, model: MorphableModel, seed: Sequence[int], scene: Scene) -> None:
        self._seed, self._scene = list(seed), scene
        known = [scheme for scheme in _SCHEMES if scheme in model.landmarks]
        self._landmarks = {scheme: model.at_landmarks(scheme) for scheme in known}

    def photos(self, numbers: range) -> Iterator[Photo]:
        """Some photos, by their numbers from 0, each drawn when it is asked for."""
        with closing(Renderer(self._scene.model, self._scene.size)) as renderer:
            for number in numbers:
                yield self._photo(number, renderer)

    def _photo(self, number: int, renderer: Renderer) -> Photo:
        rng = np.random.default_rng([*self._seed, number])
        identity, expression = self._draw_face(rng)
        landmarks = {s: part.shape(identity, expression) for s, part in self._landmarks.items()}
        framed = landmarks[self._framed]
        camera = self._draw_camera(framed, rng)
        posed, seen = pose_and_project(
            self._scene.model.shape(identity, expression), framed, camera
        )
        views = {s: pose_and_project(p, framed, camera)[1][..., :2] for s, p in landmarks.items()}
        frame = self._draw_frame(views[self._framed], rng)
        pixels = {scheme: frame.pixels(view)[0] for scheme, view in views.items()}
        albedo, lights = self._scene.albedo.sample(1, rng), sample_lights(1, rng)

        def draw(behind: np.ndarray) -> np.ndarray:
            behind = np.uint8(np.rint(255 * behind))
            return renderer.draw(seen, posed, albedo, frame, lights, behind[None])[0] / 255

        shade = lights.ambient[0] * lights.colour[0]
        places = frame.pixels(seen[..., :2])[0]
        image, left = self._draw_picture(draw, places, pixels, albedo[0], shade, rng)
        return Photo(
            name=f"{number + 1:06}.jpg",
            image=photograph(image, rng),
            landmarks={scheme: points[0] for scheme, points in landmarks.items()},
            pixels={scheme: places - (left, 0) for scheme, places in pixels.items()},
            yaw=float(camera.yaw[0]),
        )

    def _draw_face(self, rng):
        return sample_expressive(self._landmarks[_FRAMED], 1, rng)

    def _draw_camera(self, landmarks, rng):
        return sample_perspective_cameras(
            1, rng, yaw=YAW, pitch=PITCH, roll=ROLL, field_of_view=_PORTRAIT_FIELD_OF_VIEW
        )

    def _draw_frame(self, views, rng):
        """A square with room about the landmarks, which need not be in its middle."""
        low, high = views.min(1), views.max(1)
        size = (high - low).max()
        side = size * rng.uniform(*_MARGIN)
        off = _OFF_CENTRE * (side - size) * rng.uniform(-1, 1, 2)
        return Frames((low + high - side) / 2 + off, np.full((1, 2), side), PIXELS)

    def _draw_picture(self, draw, places, pixels, albedo, shade, rng):
        """The picture, in [0, 1], and the number of columns cut off at its left."""
        return draw(draw_background(PIXELS, rng)), 0


class PhotosSubstitute(Portraits):
    """Neutral faces of standard-normal identity in photos of CelebA's form.

    A photo depends on the seed and its number alone, whichever others are drawn.

    Args:
        model: Morphable model with landmarks `"bfm72"`; those of `"ibug68"` are given too, if
            known.

    Raises:
        InputError: The model cannot be coloured, or the libraries that draw are missing.
    """

    _framed = SCHEME

    def __init__(self, model: MorphableModel, n: int, seed: Sequence[int]):
        self._n = n
        self._set_up(model, seed, make_scene(model, SCHEME, HEIGHT, margin=None))
        mean = self._scene.model.mean
        self._rim = mean[:, 1] < mean[:, 1].min() + _RIM_MM
        self._crown = mean[:, 1] > mean[:, 1].max() - _CROWN_MM
        self._nose = (mean == model.mean[model.landmarks[SCHEME][_NOSE_TIP]]).all(1).argmax()

    def __len__(self) -> int:
        return self._n

    def _draw_face(self, rng):
        return rng.standard_normal((1, self._scene.model.n_identity)), None

    def _draw_camera(self, landmarks, rng):
        """A pose in which the line through the eyes is nearly level."""
        yaw = np.clip(rng.normal(0, _YAW_SD, 1), -_MAX_YAW, _MAX_YAW)
        pitch = np.clip(rng.normal(0, _PITCH_SD, 1), -_MAX_PITCH, _MAX_PITCH)
        tilt, angle = rng.normal(0, _TILT_SD, 1), rng.uniform(*_FIELD_OF_VIEW, 1)
        unrolled = Cameras(np.ones(1, int), yaw, pitch, np.zeros(1), angle)
        right, left = in_camera_frame(landmarks, unrolled)[0, _EYE_CORNERS].mean(1)
        x, y = (left - right)[:2]
        return Cameras(np.ones(1, int), yaw, pitch, tilt - np.rad2deg(np.arctan2(y, x)), angle)

    def _draw_frame(self, views, rng):
        """The square whose middle columns are the photo, by the places of the eyes in the view."""
        right, left = views[0, _EYE_CORNERS].mean(1)
        apart = _EYES_APART * np.exp(rng.normal(0, _EYES_APART_SD))
        millimetres = np.linalg.norm(left - right) / apart  # of a pixel
        x, y = _EYES_AT + rng.normal(0, _EYES_AT_SD, 2)
        corner = (x + (HEIGHT - WIDTH) / 2, HEIGHT - y)
        low = (right + left) / 2 - millimetres * np.array(corner)
        return Frames(low[None], np.full((1, 2), millimetres * HEIGHT), HEIGHT)

    def _draw_picture(self, draw, places, pixels, albedo, shade, rng):
        """The head with its hair and clothes, before a background."""
        picture = draw_background(HEIGHT, rng)
        clothes = paint(_CLOTHES[rng.integers(len(_CLOTHES))], HEIGHT, rng)
        chin = pixels[SCHEME][_CHIN]
        head = places[places[:, 1] < chin[1]]
        low, high = head.min(0), head.max(0)
        hair, skin = albedo[self._crown].mean(0), albedo[self._nose]
        if rng.random() < _LONG_HAIR and np.abs(hair - skin).max() > _BALD:
            depth = hair_depth(HEIGHT, low, high, rng)
            composite(picture, shade * hair * draw_strands(HEIGHT, rng), depth)
        # The neckline is to hide where the model ends, but not the chin.
        rim, below = places[self._rim], chin[1] + rng.uniform(*_COLLAR)
        height = max(min(below, rim[:, 1].min() - 2), chin[1] + _COLLAR[0] / 2)
        collar, neck = np.array([rim[:, 0].mean(), height]), _NECK * (high[0] - low[0]) / 2
        front, back = clothes_depth(HEIGHT, collar, neck, rng)
        composite(picture, _SHADE * clothes, back)
        image = draw(picture)
        composite(image, clothes, front)
        return image[:, _BESIDE:-_BESIDE], _BESIDE
