"""Faces and views of the protocol `hard`, and the conditions under which methods are compared."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np

from data_gen.models.morphable_model import MorphableModel
from data_gen.views import hidden_by_head, sample_cameras, sample_hard_cameras
from deepmds_keras.geometry.views import Cameras, project
from experiments.inputs import face_model
from experiments.run import Run
from experiments.streams import Stream

FACE_MM = 90.0  # between the outer corners of the eyes; noise is relative to it
MOST_MISSING = 0.6  # share of the landmarks in training
HIDDEN = "hidden"
_CAMERAS = {"paper": sample_cameras, "hard": sample_hard_cameras}


@dataclass(frozen=True)
class Condition:
    """Kind of views.

    Attributes:
        id, title: Name in CSV files, and in tables for readers.
        protocol: Protocol of the cameras, one of `_CAMERAS`.
        noise: Standard deviation of a coordinate's noise, percent of `FACE_MM`.
        missing: Share of randomly missing landmarks, in training the largest one; or `HIDDEN` for
            those that the head hides.
    """

    id: str
    title: str = ""
    protocol: str = "hard"
    noise: float = 0.0
    missing: float | str = 0.0

    @property
    def training(self) -> Condition:
        """Condition of its training views, the same for all shares of missing landmarks."""
        name = f"{self.protocol}_{self.noise:g}{'_missing' * bool(self.missing)}"
        return replace(self, id=name, missing=MOST_MISSING if self.missing else 0.0)

    def rng(self, run: Run, stream: Stream) -> np.random.Generator:
        """Random numbers that all conditions of a protocol share."""
        return np.random.default_rng([run.seed, stream, [*_CAMERAS].index(self.protocol)])


CONDITIONS = (
    Condition("paper_0", "paper, exact", protocol="paper"),
    Condition("hard_0", "hard, exact"),
    Condition("hard_1", "hard, 1 %", noise=1),
    Condition("hard_3", "hard, 3 %", noise=3),
    Condition("hard_1_missing_30", "1 %, 30 % missing", noise=1, missing=0.3),
    Condition("hard_1_missing_50", "1 %, 50 % missing", noise=1, missing=0.5),
    Condition("hard_1_hidden", "1 %, hidden missing", noise=1, missing=HIDDEN),
)


@dataclass(frozen=True, eq=False)
class Views:
    """Faces and a view of each, millimetres.

    Attributes:
        identity: `(n, K)` standard-normal coefficients.
        shapes: `(n, L, 3)` true landmarks.
        views: `(n, L, 2)` landmarks in the image, NaN where one is missing.
        sd_mm: `(n,)` standard deviation of the landmarks' noise in the image.
    """

    identity: np.ndarray
    shapes: np.ndarray
    views: np.ndarray
    sd_mm: np.ndarray
    cameras: Cameras

    def __len__(self) -> int:
        return len(self.views)

    def __getitem__(self, faces) -> Views:
        return Views(**{name: array[faces] for name, array in vars(self).items()})

    def without(self, missing: np.ndarray) -> Views:
        """The same faces without the landmarks that are missing, `(n, L)` bool."""
        return replace(self, views=np.where(missing[..., None], np.nan, self.views))


@functools.cache
def landmark_model(run: Run) -> MorphableModel:
    """The run's face model restricted to the landmarks."""
    return face_model(run).at_landmarks(run.scheme)


def sample_views(run: Run, condition: Condition, n: int, rng: np.random.Generator) -> Views:
    """Random neutral faces, their views and noise; no landmark is missing."""
    identity, shapes = landmark_model(run).sample(n, rng)
    cameras = _CAMERAS[condition.protocol](n, rng)
    # No longer used, but later draws, and so the published numbers, depend on it.
    rng.random(n)
    sd = np.full(n, condition.noise / 100 * FACE_MM)
    views = project(shapes, cameras)
    views += sd[:, None, None] * rng.standard_normal(views.shape)
    return Views(identity, shapes, views, sd, cameras)


def training_views(run: Run, condition: Condition) -> Views:
    """Training faces for a condition; each lacks up to a share of its landmarks."""
    training, rng = condition.training, condition.rng(run, Stream.HARD_TRAINING)
    faces = sample_views(run, training, run.preset.train_faces, rng)
    if not training.missing:
        return faces
    share = training.missing * rng.random((len(faces), 1))
    return faces.without(rng.random(faces.views.shape[:2]) < share)


def hard_views(run: Run, condition: Condition) -> Views:
    """The test faces: the same in every condition of a protocol, with the same noise in its unit.

    A landmark missing at one share is missing at all larger ones.
    """
    rng = condition.rng(run, Stream.HARD_FACES)
    faces = sample_views(run, condition, run.preset.test_faces, rng)
    if condition.missing == HIDDEN:
        model = face_model(run)
        return faces.without(hidden_by_head(model, run.scheme, faces.identity, faces.cameras))
    rng = np.random.default_rng([run.seed, Stream.HARD_MISSING])
    return faces.without(rng.random(faces.views.shape[:2]) < condition.missing)
