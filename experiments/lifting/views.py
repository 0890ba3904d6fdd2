"""Faces and views of the protocol `hard`, and the conditions under which methods are compared."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from data_gen.models.morphable_model import MorphableModel
from data_gen.models.registry import load_model
from data_gen.views.hidden import hidden_by_head
from data_gen.views.projections import Cameras, project, sample_cameras, sample_hard_cameras
from deepmds_keras.io.archives import read_arrays, write_arrays
from experiments.progress import Bar
from experiments.run import Run
from experiments.streams import Stream
from experiments.tasks import unordered

FACE_MM = 90.0  # between the outer corners of the eyes; noise is a share of it
HIDDEN = "hidden"
MOST_MISSING = 0.6  # share of the landmarks in training
_FACES_PER_TASK = 100  # that looks for hidden landmarks
_CAMERAS: dict[str, Callable[[int, np.random.Generator], Cameras]] = {
    "paper": sample_cameras,
    "hard": sample_hard_cameras,
}


@dataclass(frozen=True)
class Condition:
    """What test views are like.

    Attributes:
        id: As in the tables.
        title: As in the tables that are read.
        protocol: Of the cameras, one of `_CAMERAS`.
        noise: Standard deviation of the errors of a coordinate, percent of `FACE_MM`.
        missing: Share of the landmarks that are missing, each at random; or `HIDDEN`, those that
            the head hides.
        mixed: Whether each face has a noise of its own, up to this one.
    """

    id: str
    title: str
    protocol: str = "hard"
    noise: float = 0.0
    missing: float | str = 0.0
    mixed: bool = False

    def sample_sd(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Standard deviation of the errors of a coordinate of each face, `(n,)` millimetres."""
        # Little noise more often than much: errors are smaller there.
        share = rng.random(n) ** 2
        return self.noise / 100 * FACE_MM * (share if self.mixed else np.ones(n))

    @property
    def place(self) -> int:
        """Number of the protocol, of the random streams."""
        return [*_CAMERAS].index(self.protocol)

    @property
    def training(self) -> str:
        """Id of the training views of methods that are trained for a condition."""
        missing, mixed = "_missing" * bool(self.missing), "_mixed" * self.mixed
        return f"{self.protocol}_{self.noise:g}{missing}{mixed}"


CONDITIONS = (
    Condition("paper_0", "paper, exact", protocol="paper"),
    Condition("hard_0", "hard, exact"),
    Condition("hard_1", "hard, 1 %", noise=1),
    Condition("hard_3", "hard, 3 %", noise=3),
    Condition("hard_1_missing_30", "1 %, 30 % missing", noise=1, missing=0.3),
    Condition("hard_1_missing_50", "1 %, 50 % missing", noise=1, missing=0.5),
    Condition("hard_1_hidden", "1 %, hidden missing", noise=1, missing=HIDDEN),
)
# What the large lifting network is trained on: all of the hard conditions at once.
MIXED = Condition("hard_mixed", "hard, mixed", noise=3, missing=MOST_MISSING, mixed=True)
# Of each training, a condition with its protocol and noise.
TRAININGS = {condition.training: condition for condition in reversed(CONDITIONS)}


@dataclass(frozen=True, eq=False)
class HardFaces:
    """Faces and a view of each, millimetres.

    Attributes:
        identity: `(n, K)` standard-normal coefficients.
        shapes: `(n, L, 3)` true landmarks.
        views: `(n, L, 2)` landmarks in the image, NaN where one is missing.
        sd_mm: `(n,)` standard deviation of the errors of the landmarks in the image.
        cameras: Pose and projection of each face.
    """

    identity: np.ndarray
    shapes: np.ndarray
    views: np.ndarray
    sd_mm: np.ndarray
    cameras: Cameras

    def __len__(self) -> int:
        return len(self.views)

    def __getitem__(self, faces) -> HardFaces:
        return HardFaces(**{name: own[faces] for name, own in vars(self).items()})

    def without(self, missing: np.ndarray) -> HardFaces:
        """The same faces without the landmarks that are missing, `(n, L)` bool."""
        return replace(self, views=np.where(missing[..., None], np.nan, self.views))


@functools.cache
def face_model(run: Run) -> MorphableModel:
    """The run's face model."""
    return load_model(run.model, run.data)


def landmark_model(run: Run) -> MorphableModel:
    """The run's face model restricted to the landmarks."""
    model = face_model(run)
    return model.restrict(model.landmarks[run.scheme])


def sample_views(
    landmarks: MorphableModel, condition: Condition, n: int, rng: np.random.Generator
) -> HardFaces:
    """Random neutral faces, their views and noise; no landmark is missing.

    Args:
        landmarks: As from `landmark_model`.
        condition: Of the views.
        n: Number of faces.
        rng: Source of the random numbers, of which as many are drawn whatever the noise.
    """
    identity, shapes = landmarks.sample(n, rng)
    cameras = _CAMERAS[condition.protocol](n, rng)
    views, sd = project(shapes, cameras), condition.sample_sd(n, rng)
    views += sd[:, None, None] * rng.standard_normal(views.shape)
    return HardFaces(identity, shapes, views, sd, cameras)


def sample_training(
    landmarks: MorphableModel, condition: Condition, n: int, rng: np.random.Generator
) -> HardFaces:
    """Faces to train on: where landmarks are missing, of each face a share up to `MOST_MISSING`."""
    faces = sample_views(landmarks, condition, n, rng)
    if not condition.missing:
        return faces
    share = MOST_MISSING * rng.random((n, 1))
    return faces.without(rng.random(faces.views.shape[:2]) < share)


def training_faces(run: Run, condition: Condition) -> HardFaces:
    """The faces that methods which need them all at once are trained on."""
    rng = np.random.default_rng([run.seed, Stream.HARD_TRAINING, condition.place])
    return sample_training(landmark_model(run), condition, run.preset.train_faces, rng)


def hard_faces(run: Run, condition: Condition) -> HardFaces:
    """The test faces: the same in every condition of a protocol, with the same errors in its unit.

    Raises:
        InputError: Landmarks that the head hides are asked for before `find_hidden`.
    """
    rng = np.random.default_rng([run.seed, Stream.HARD_FACES, condition.place])
    faces = sample_views(landmark_model(run), condition, run.preset.test_faces, rng)
    if condition.missing == HIDDEN:
        return faces.without(read_arrays(_hidden_file(run))[0]["hidden"])
    # What is missing at one share is so at all larger ones.
    rng = np.random.default_rng([run.seed, Stream.HARD_MISSING])
    return faces.without(rng.random(faces.views.shape[:2]) < condition.missing)


def find_hidden(run: Run) -> None:
    """Write which landmarks the heads of the hard test faces hide, unless it is written."""
    path = _hidden_file(run)
    if path.exists():
        return
    (condition,) = (c for c in CONDITIONS if c.missing == HIDDEN)
    faces = hard_faces(run, replace(condition, missing=0))
    hidden = np.zeros(faces.views.shape[:2], bool)
    starts = range(0, len(faces), _FACES_PER_TASK)
    tasks = ((run, faces[start : start + _FACES_PER_TASK], start) for start in starts)
    with Bar(total=len(faces), desc="hidden landmarks", unit="face") as bar:
        for start, own in unordered(run.jobs, _hidden_of, tasks):
            hidden[start : start + len(own)] = own
            bar.update(len(own))
    write_arrays(path, {"hidden": hidden}, {})


def _hidden_of(run: Run, faces: HardFaces, start: int) -> tuple[int, np.ndarray]:
    return start, hidden_by_head(face_model(run), run.scheme, faces.identity, faces.cameras)


def _hidden_file(run: Run) -> Path:
    return run.work / "hard" / "hidden.npz"
