"""Training of nets on pairs of landmarks, those of one face or of all in a mini-batch."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Self

import keras
import numpy as np

from deepmds_keras.geometry.classical_scaling import pairwise_distances
from deepmds_keras.proximities import pair_features, proximities
from deepmds_keras.streams import Stream
from deepmds_keras.training import Recipe, compiled_by_xla, face_order, train_by_epoch
from deepmds_keras.weights import fingerprint

_CHUNK = 8  # faces at a time in use
_CHECKED_FACES = 50


@dataclass
class PairNet:
    """Training of a net on pairs of landmarks by Adam, as the paper's or with shuffled pairs.

    Args:
        network: Net of `build_pair_net`, or any on the paper's pair features.
        recipe: Epochs, steps and schedule.
        seed: Seed of the order of the faces, or of the pairs that are drawn.
        shuffled: Whether a mini-batch has the same number of pairs drawn from all faces instead of
            those of one face (the other scheme of the paper's "Ablation Study").
    """

    network: keras.Model
    recipe: Recipe
    seed: int
    shuffled: bool = False

    @property
    def epochs(self) -> int:
        return self.recipe.epochs

    def fit(
        self,
        frontal: np.ndarray,
        views: np.ndarray,
        shapes: np.ndarray,
        *,
        checkpoint: Path | None = None,
        progress: Callable | None = None,
    ) -> Self:
        """Train, or resume from a checkpoint.

        Args:
            frontal: `(n, L, 2)` views whose pairs are used.
            views, shapes: `(n, L, 2)` and `(n, L, 3)`, normalised.
            checkpoint, progress: As for `train_by_epoch`.
        """
        n, n_landmarks = shapes.shape[:2]
        frontal, views, shapes = (np.asarray(a, np.float32) for a in (frontal, views, shapes))
        flat_views, pairs = views.reshape(n, -1), _pairs(n_landmarks)
        steps, n_pairs = self.recipe.steps_per_epoch or n, len(pairs)
        n_inputs = len(self.network.inputs)

        def mini_batch(faces: np.ndarray, drawn: np.ndarray) -> tuple:
            faces, (first, second) = np.broadcast_to(faces, drawn.shape), pairs[drawn].T
            features = proximities(frontal[faces, first], frontal[faces, second], "paper")
            distances = np.linalg.norm(shapes[faces, first] - shapes[faces, second], axis=-1)
            return _inputs(n_inputs, features, pairs[drawn], flat_views[faces]), distances[:, None]

        def mini_batches(epoch: int) -> dict:
            faces = face_order(n, steps, self.seed, epoch)[:, None]
            drawn = np.broadcast_to(np.arange(n_pairs), (steps, n_pairs))
            if self.shuffled:
                rng = np.random.default_rng([self.seed, Stream.SHUFFLED_PAIRS, epoch])
                faces, drawn = (rng.integers(m, size=(steps, n_pairs)) for m in (n, n_pairs))
            # One after the other: all pairs of an epoch would fill the memory.
            batches = (mini_batch(*chosen) for chosen in zip(faces, drawn, strict=True))
            return {"x": batches, "steps_per_epoch": steps}

        known = slice(_CHECKED_FACES)
        distances = pairwise_distances(shapes[known])

        def inference() -> float:
            estimated = dissimilarities(self.network, frontal[known], views[known])
            return float(np.mean((estimated - distances)[:, pairs[:, 0], pairs[:, 1]] ** 2))

        data = fingerprint(frontal, views, shapes)
        label = {"seed": self.seed, "data": data, "shuffled": self.shuffled, **asdict(self.recipe)}
        model = compiled_by_xla(self.network, self.recipe.optimizer(steps), steps)
        self.history_ = train_by_epoch(model, mini_batches, label, inference, checkpoint, progress)
        return self


def dissimilarities(net: keras.Model, frontal: np.ndarray, views: np.ndarray) -> np.ndarray:
    """Matrices `(n, L, L)` of the distances that a net predicts, with zero diagonal.

    The net is one of `build_pair_net`, or the method's; pairs come from `frontal`, `views` are
    whole.
    """
    frontal = np.asarray(frontal, np.float32)
    views = np.asarray(views, np.float32).reshape(len(views), -1)
    n_landmarks, pairs = frontal.shape[1], _pairs(frontal.shape[1])
    matrices = np.zeros((len(frontal), n_landmarks, n_landmarks), np.float32)
    for start in range(0, len(frontal), _CHUNK):
        part = slice(start, start + _CHUNK)
        features = pair_features(frontal[part])
        n = len(features)
        flat = features.reshape(n * len(pairs), -1)
        whole = np.repeat(views[part], len(pairs), 0)
        inputs = _inputs(len(net.inputs), flat, np.tile(pairs, (n, 1)), whole)
        distances = net.predict_on_batch(inputs)
        matrices[part, pairs[:, 0], pairs[:, 1]] = distances.reshape(n, -1)
    return matrices + np.swapaxes(matrices, 1, 2)


def _inputs(n_inputs: int, features, landmarks, views):
    """What a net of `build_pair_net` takes: features, then landmarks, then whole views."""
    return features if n_inputs == 1 else (features, landmarks, views)[:n_inputs]


def _pairs(n_landmarks: int) -> np.ndarray:
    """`(P, 2)` numbers of the landmarks of every pair."""
    return np.stack(np.triu_indices(n_landmarks, 1), 1).astype(np.int32)
