"""Colours of faces, from the model or painted on its mean, and the light on them."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from matplotlib.path import Path as Polygon
from scipy.spatial import KDTree

from data_gen.models.mesh import components, vertex_normals
from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.errors import InputError

# Ramps of sRGB colours, from which faces sample uniformly.
_SKIN = np.array([[246, 214, 194], [214, 164, 132], [156, 104, 76], [92, 58, 44]]) / 255
_HAIR = (
    np.array([[28, 22, 20], [58, 40, 30], [110, 80, 54], [176, 142, 100], [150, 148, 146]]) / 255
)
_IRIS = np.array([[54, 36, 26], [96, 66, 40], [96, 110, 80], [104, 132, 156]]) / 255
_SCLERA, _PUPIL, _TEETH = (
    np.array(c) / 255 for c in ([226, 220, 214], [16, 14, 14], [206, 198, 184])
)
_LIP_RED = np.array([0.88, 0.62, 0.62])  # largest part of the skin's channels that lips keep
_IRIS_MM, _PUPIL_MM, _BROW_MM, _LID_MM = 5.9, 2.2, 3.6, 1.6
_EAR, _EAR_MM = np.array([0.0, 0.0, -16.0]), 26.0  # middle, from the jaw line near it; radius
_MOTTLE, _N_WAVES, _WAVE_MM = 0.03, 6, 60.0
_SOURCES = ("skin", "lips", "brow", "lid", "hair", "sclera", "iris", "pupil", "teeth")
_CAVITY, _CAVITY_MM = np.array([58, 24, 24]) / 255, 5.0  # so far behind the lips it begins


class Albedo:
    """A map of materials on a face model, and random colours of them for faces.

    A model with colour statistics (the Basel models) is coloured by those. One without (open head,
    ICT) is painted: skin of any tone, lips, brows, lid rims, hair, eyes and teeth, located on the
    mean face by its iBUG landmarks, and a faint mottling.

    Args:
        model: Morphable model, with colours or with landmarks `"ibug68"`.
        vertices: `(v,)` the vertices to colour; all by default.
        open_mouths: Whether to paint the inside of the mouth too, which closed lips hide.

    Raises:
        InputError: The model has neither.
    """

    def __init__(
        self,
        model: MorphableModel,
        vertices: np.ndarray | None = None,
        *,
        open_mouths: bool = False,
    ):
        chosen = slice(None) if vertices is None else vertices
        self._mean_colour = self._basis = None
        if model.colour_mean is None:
            self._cover = _cover(model, open_mouths)[:, chosen]
            self._places = model.mean[chosen]
        else:
            self._mean_colour = np.float32(model.colour_mean[chosen])
            self._basis = np.float32(model.colour_basis_times_sd[:, chosen])

    def sample(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Colours of n faces, `(n, v, 3)` float32, sRGB in [0, 1]."""
        if self._basis is not None:
            weights = np.float32(rng.standard_normal((n, len(self._basis))))
            colours = self._mean_colour + np.tensordot(weights, self._basis, 1)
            return colours.clip(0, 1)
        palette = _palette(n, rng)[:, : len(self._cover)]
        colours = np.einsum("nsc,sv->nvc", palette, self._cover)
        return np.float32((colours * (1 + self._mottling(n, rng))[..., None]).clip(0, 1))

    def _mottling(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Slow waves over the face, so that no skin has a single colour: `(n, v)`."""
        directions = rng.standard_normal((n, _N_WAVES, 3)) / _WAVE_MM
        phases = rng.uniform(0, 2 * np.pi, (n, _N_WAVES, 1))
        waves = np.sin(directions @ self._places.T * (2 * np.pi / 3) + phases)
        return _MOTTLE * waves.sum(1) / np.sqrt(_N_WAVES)


def _palette(n: int, rng: np.random.Generator) -> np.ndarray:
    """Colours of the materials of n faces, and of the mouth inside: `(n, len(_SOURCES) + 1, 3)`."""
    tone = rng.random(n)
    skin = _along(_SKIN, tone) * rng.normal(1, 0.015, (n, 3))
    red = rng.uniform(0.35, 1, (n, 1))
    # Hair is at least as dark as the skin; the lightest goes with light skin only.
    hair = _along(_HAIR, rng.random(n) * (1 - 0.7 * tone))
    shaved = rng.random((n, 1)) < 0.15
    brow = 0.3 * skin + 0.7 * hair
    colours = {
        "skin": skin,
        "lips": skin * (1 + red * (_LIP_RED - 1)),
        "brow": brow,
        "lid": 0.45 * skin,
        "hair": np.where(shaved, skin, hair),
        "sclera": np.broadcast_to(_SCLERA, (n, 3)),
        "iris": _along(_IRIS, rng.random(n) * (1 - 0.6 * tone)),
        "pupil": np.broadcast_to(_PUPIL, (n, 3)),
        "teeth": np.broadcast_to(_TEETH, (n, 3)),
    }
    ordered = [colours[source] for source in _SOURCES]
    return np.stack([*ordered, np.broadcast_to(_CAVITY, (n, 3))], axis=1)


def _along(ramp: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Colours at places in [0, 1] along a ramp: `(n,)` → `(n, 3)`."""
    stops = np.linspace(0, 1, len(ramp))
    return np.stack([np.interp(place, stops, channel) for channel in ramp.T], axis=-1)


def _cover(model: MorphableModel, open_mouths: bool) -> np.ndarray:
    """Share of each vertex that each material covers, `(len(_SOURCES), V)`, 1 in sum.

    With open mouths there is a last row for the inside of the mouth.
    """
    if "ibug68" not in model.landmarks:
        raise InputError(
            f"{model.name} must have colours, or the landmarks ibug68, by which to paint it. "
            "Received a model with neither."
        )
    mean = model.mean
    front = mean[:, :2]
    landmarks = mean[model.landmarks["ibug68"]]
    eyes, nose_base = (landmarks[36:42], landmarks[42:48]), landmarks[33]
    brows, mouth = (landmarks[17:22], landmarks[22:27]), landmarks[48:60]
    part = components(model.n_vertices, model.triangles)
    skin = part == 0
    facing = vertex_normals(mean, model.triangles)[:, 2] > -0.2
    facing &= mean[:, 2] > landmarks[[36, 45], 2].min() - 15

    layers = {source: np.zeros(model.n_vertices) for source in _SOURCES}
    layers["skin"][:] = 1
    layers["hair"] = _hair(mean, landmarks) * skin
    layers["brow"] = _near(brows, mean, _BROW_MM) * skin
    inside = Polygon(mouth[:, :2]).contains_points(front) & (_distance(mouth, mean) < 15)
    rim, *lids = (np.vstack([outline, outline[:1]]) for outline in (mouth, *eyes))
    layers["lips"] = np.maximum(inside, _near([rim], mean, 1.5)) * (skin & facing)
    layers["lid"] = _near(lids, mean, _LID_MM) * (skin & facing)
    for number in range(1, part.max() + 1):
        inside = part == number
        if mean[inside, 1].mean() < nose_base[1]:
            layers["teeth"][inside] = 1
            continue
        # The optical axis of an eyeball runs through its middle, straight ahead.
        middle = (front[inside].min(0) + front[inside].max(0)) / 2
        off_axis = np.linalg.norm(front - middle, axis=1)
        ahead = inside & (mean[:, 2] > mean[inside, 2].mean())
        layers["sclera"][inside] = 1
        layers["iris"] = np.maximum(layers["iris"], ahead * _soft(off_axis, _IRIS_MM))
        layers["pupil"] = np.maximum(layers["pupil"], ahead * _soft(off_axis, _PUPIL_MM))
    if open_mouths:
        depth = mouth[KDTree(mouth[:, :2]).query(front)[1], 2] - mean[:, 2]
        layers["cavity"] = skin * Polygon(mouth[:, :2]).contains_points(front, radius=3.0)
        layers["cavity"] = layers["cavity"] * np.clip(depth / _CAVITY_MM - 1, 0, 1) * (depth < 60)
    cover = np.zeros((len(layers), model.n_vertices))
    for number, layer in enumerate(layers.values()):
        cover *= 1 - layer  # each layer hides the earlier ones where it covers
        cover[number] = layer
    return cover


def _hair(mean: np.ndarray, landmarks: np.ndarray) -> np.ndarray:
    """Above the forehead, and behind and above the ears."""
    brow, chin = landmarks[17:27, 1].mean(), landmarks[8, 1]
    ear = landmarks[[0, 16], 2].mean()
    hairline = brow + 0.42 * (brow - chin)
    behind = np.clip((ear + 25 - mean[:, 2]) / 60, 0, 1)  # the hairline falls towards the neck
    hair = 1 / (1 + np.exp(-(mean[:, 1] - hairline + behind * (hairline - chin)) / 2.5))
    return hair * (1 - _soft(_distance(landmarks[[0, 16]] + _EAR, mean), _EAR_MM))


def _near(lines: Iterable[np.ndarray], points: np.ndarray, width: float) -> np.ndarray:
    """Coverage of points by polylines of that half width."""
    dense = []  # points less than a millimetre apart
    for line in lines:
        steps = np.linspace(0, len(line) - 1, 60 * (len(line) - 1) + 1)
        dense += [np.stack([np.interp(steps, np.arange(len(line)), axis) for axis in line.T], 1)]
    return _soft(_distance(np.concatenate(dense), points), width)


def _soft(distance: np.ndarray, width: float) -> np.ndarray:
    """1 within the width, falling to 0 over half of it."""
    return np.clip(1 + 2 * (width - distance) / width, 0, 1)


def _distance(line: np.ndarray, points: np.ndarray) -> np.ndarray:
    return KDTree(line).query(points)[0]


@dataclass(frozen=True, eq=False)
class Lights:
    """Light on each of `n` faces: ambient, and one far lamp.

    Attributes:
        direction: `(n, 3)` unit vectors to the lamp in the camera's frame.
        ambient: `(n,)` share of the albedo that is visible without the lamp.
        colour: `(n, 3)` colour of all light, as reflected by a white surface facing the lamp.
    """

    direction: np.ndarray
    ambient: np.ndarray
    colour: np.ndarray


def sample_lights(n: int, rng: np.random.Generator) -> Lights:
    """Lamps up to 60 degrees to the side of the camera, and from 10 below it to 60 above."""
    aside, above = np.deg2rad(rng.uniform(-60, 60, n)), np.deg2rad(rng.uniform(-10, 60, n))
    across = np.cos(above)
    direction = np.stack([np.sin(aside) * across, np.sin(above), np.cos(aside) * across], axis=1)
    ambient = rng.uniform(0.35, 0.65, n)
    return Lights(direction, ambient, rng.uniform(0.8, 1.15, (n, 1)) * rng.normal(1, 0.015, (n, 3)))
