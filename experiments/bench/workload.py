"""Faces, networks and matrices on which the parts of the method are timed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import keras
import numpy as np
from scipy.spatial.distance import squareform

from data_gen.datasets.dataset import make_dataset
from data_gen.models.morphable_model import MorphableModel
from data_gen.models.registry import load_model
from deepmds_keras.embedding import SOLVERS, embed
from deepmds_keras.lifting.lifter import LandmarkLifter
from deepmds_keras.networks import forward
from deepmds_keras.normalisation import normalise
from deepmds_keras.pipeline import DeepMDS
from deepmds_keras.proximities import pair_features
from experiments.run import Run
from experiments.streams import Stream

SCHEME, WEIGHTS = "bfm72", "deepmds-bfm72"
_FACES_PER_CHUNK = 1024  # whose matrices are in memory at once, as in `DeepMDS.predict`
_MATRICES = 2048  # different ones; rows of more faces go through them again


@dataclass(frozen=True, eq=False)
class Workload:
    """Workload that is timed on.

    Attributes:
        run: The run.
        model: Face model.
        networks: The weights that ship with the package, whatever the face model is.
        views: `(n, 72, 2)` views, as many as the largest row of their number needs.
        shapes: `(m, 72, 3)` normalised shapes of some of them.
        matrices: `(m, 72, 72)` dissimilarities of those.
    """

    run: Run
    model: MorphableModel
    networks: DeepMDS
    views: np.ndarray
    shapes: np.ndarray
    matrices: np.ndarray

    @property
    def n_landmarks(self) -> int:
        return self.views.shape[1]

    @cached_property
    def lifter(self) -> LandmarkLifter:
        """The small lifting network after one step of training: no weight changes its time."""
        shapes = self.shapes
        return LandmarkLifter(self.n_landmarks, steps=1).fit(self.first_views(len(shapes)), shapes)

    def first_views(self, n: int) -> np.ndarray:
        """The first n views; where there are fewer, those again."""
        return self.views[np.arange(n) % len(self.views)]

    def rng(self, *numbers: int) -> np.random.Generator:
        """Random numbers of the run's seed, of this stage."""
        return np.random.default_rng([self.run.seed, Stream.BENCH, *numbers])


def make_workload(run: Run) -> Workload:
    """Random faces of the run's model, and what the shipped weights make of them."""
    model = load_model(run.model, run.data, SCHEME)
    networks = DeepMDS.pretrained(WEIGHTS)
    n = max(*run.preset.bench_many_faces, run.preset.bench_faces)
    rng = np.random.default_rng([run.seed, Stream.BENCH])
    faces = make_dataset(model, n, rng, scheme=SCHEME, protocol=run.protocol)
    some = slice(min(n, _MATRICES))
    matrices = np.abs(networks.dissimilarities(faces.views[some]))
    for solver in SOLVERS:
        embed(matrices[:1], solver=solver)  # what the first call loads is part of no row
    return Workload(
        run=run,
        model=model,
        networks=networks,
        views=faces.views,
        shapes=np.float32(normalise(faces.landmarks[some])),
        matrices=matrices,
    )


def predict_all(networks: DeepMDS, views: np.ndarray) -> None:
    """Dissimilarities of views, of which only a chunk is kept at a time."""
    for chunk in _chunks(len(views)):
        networks.dissimilarities(views[chunk])


def embed_all(matrices: np.ndarray, n: int, solver: str, jobs: int = 1) -> list[np.ndarray]:
    """Shapes of n faces chunk by chunk; where there are fewer matrices, those again."""
    faces = [np.arange(chunk.start, chunk.stop) % len(matrices) for chunk in _chunks(n)]
    return [embed(matrices[own], solver=solver, n_jobs=jobs) for own in faces]


def dissimilarities(network: keras.Model, frontal: np.ndarray, variant: str) -> np.ndarray:
    """Dissimilarities of true frontal views, of any number of landmarks.

    Args:
        network: Dissimilarity net.
        frontal: `(n, L, 2)` views.
        variant: Of the pair features.

    Returns:
        `(n, L, L)`, not negative, diagonal 0.
    """
    distances = [forward(network, pair_features(view, variant)) for view in normalise(frontal)]
    return np.stack([squareform(np.abs(own.ravel())) for own in distances])


def _chunks(n: int) -> Iterator[slice]:
    for start in range(0, n, _FACES_PER_CHUNK):
        yield slice(start, min(start + _FACES_PER_CHUNK, n))
