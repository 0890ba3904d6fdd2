"""Faces that the shipped lifters are trained on: of both open models, and of neither.

Every face is changed beyond its model, since the people in photos are of no model at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from data_gen.models.morphable_model import MorphableModel
from data_gen.views.photo_views import sample_expressive
from data_gen.views.projections import Cameras, project, sample_perspective_cameras
from deepmds_keras.detection.errors import DetectorErrors
from deepmds_keras.normalisation import rms_radius
from experiments.pretrained.detector_errors import N_INNER, turned

# Uniform, to either side, degrees; and the angle that the landmarks fill, from 0.
_YAW, _PITCH, _ROLL, _FIELD_OF_VIEW = 90.0, 40.0, 40.0, 40.0
# What models do not have: larger features, smooth offsets, landmarks set elsewhere, other aspects.
_IDENTITY = (0.8, 1.4)
_SMOOTH_MM, _SMOOTH_SD_MM = 25.0, 3.0
_OFFSET_SD_MM, _ASPECT_SD = 2.0, 0.05
_MOST_NOISE_MM = 6.0
# A detector may do better or worse on the photos of a user than on those drawn here.
_STRENGTH = (0.6, 1.4)
# Of faces as they were found, where there are any. What errors owe to the face is drawn as if it
# were linear, and of all models alike: of 68 landmarks on the open head that misses a part.
_SHARE_FOUND = 0.25


class FoundFaces(NamedTuple):
    """Faces of photos with known shapes, as a detector found them.

    Attributes:
        views: `(n, L, 2)` what it found, y up, any scale.
        shapes: `(n, L, 3)` true landmarks.
        sd: `(n, L)` of its errors, in the unit of the views.
    """

    views: np.ndarray
    shapes: np.ndarray
    sd: np.ndarray


@dataclass(frozen=True, eq=False)
class PhotoFaces:
    """Samples faces as detectors find them in photos, for `LandmarkLifter.fit`.

    Attributes:
        models: Morphable models with the landmarks of the scheme, of which equal parts are.
        scheme: Landmark scheme.
        errors: Of detectors, in the landmarks of the scheme; of as many faces as of each of them
            the errors are white.
        found: What detectors found in photos, mixed in as it is.
    """

    models: Sequence[MorphableModel]
    scheme: str
    errors: Sequence[DetectorErrors] = ()
    found: Sequence[FoundFaces] = ()
    _parts: list = field(init=False, repr=False)

    def __post_init__(self):
        parts = [model.restrict(model.landmarks[self.scheme]) for model in self.models]
        smooth = [_smooth_basis(part.mean) for part in parts]
        object.__setattr__(self, "_parts", [*zip(parts, smooth, strict=True)])

    def __call__(
        self, n: int, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Views `(n, L, 2)`, shapes `(n, L, 3)` and s.d. `(n, L)` of the errors."""
        faces = self._drawn(n, rng)
        if self.found:
            kind = rng.integers(len(self.found), size=n)
            kind[rng.random(n) >= _SHARE_FOUND] = -1
            for k, own in enumerate(self.found):
                places = np.flatnonzero(kind == k)
                chosen = rng.integers(len(own.views), size=len(places))
                for array, known in zip(faces, own, strict=True):
                    array[places] = known[chosen]
        return faces

    def _drawn(self, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        share = np.arange(n) * len(self._parts) // n
        shapes = [
            _beyond(part, smooth, int((share == k).sum()), rng)
            for k, (part, smooth) in enumerate(self._parts)
        ]
        shapes = rng.permutation(np.concatenate(shapes))
        cameras = sample_perspective_cameras(
            n, rng, yaw=_YAW, pitch=_PITCH, roll=_ROLL, field_of_view=(0, _FIELD_OF_VIEW)
        )
        views = project(shapes, cameras)
        white = _MOST_NOISE_MM * rng.random((n, 1)) ** 2
        errors = white[..., None] * rng.standard_normal(views.shape)
        sd = np.repeat(white, views.shape[1], axis=1)
        kind = rng.integers(len(self.errors) + 1, size=n)
        for k, own in enumerate(self.errors):
            faces = np.flatnonzero(kind == k)
            drawn, radius = errors_in_views(own, views[faces], cameras[faces], rng)
            strength = rng.uniform(*_STRENGTH, (len(faces), 1))
            errors[faces] = strength[..., None] * drawn
            sd[faces] = strength * radius[:, None] * own.sd
        return views + errors, shapes, sd


def errors_in_views(
    measured: DetectorErrors, views: np.ndarray, cameras: Cameras, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Random errors of a detector in exact views `(n, L, 2)`, y up.

    Returns:
        `(n, L, 2)` errors and `(n,)` radii of the views, in the unit of these.
    """
    inner = views[:, -N_INNER:]
    radius = rms_radius(inner)
    unit = radius[:, None, None]
    upright = turned((views - inner.mean(1, keepdims=True)) / unit, -cameras.roll)
    errors = measured.sample(upright, cameras.yaw, rng)
    return unit * turned(errors, cameras.roll), radius


def _smooth_basis(mean: np.ndarray) -> np.ndarray:
    """`(L, L)`: times white noise it gives offsets alike for landmarks that lie together."""
    squares = ((mean[:, None] - mean) ** 2).sum(2)
    kernel = np.exp(-squares / (2 * _SMOOTH_MM**2))
    return np.linalg.cholesky(kernel + 1e-6 * np.eye(len(mean)))


def _beyond(
    part: MorphableModel, smooth: np.ndarray, n: int, rng: np.random.Generator
) -> np.ndarray:
    """`(n, L, 3)` faces of a model, changed in ways that it does not have."""
    identity, expression = sample_expressive(part, n, rng)
    shapes = part.shape(identity * rng.uniform(*_IDENTITY, (n, 1)), expression)
    bend = _SMOOTH_SD_MM * rng.random((n, 1, 1)) * (smooth @ rng.standard_normal(shapes.shape))
    offset = _OFFSET_SD_MM * rng.random((n, 1, 1)) * rng.standard_normal(shapes.shape)
    aspect = 1 + _ASPECT_SD * rng.standard_normal((n, 1, 3))
    return aspect * (shapes + bend + offset)
