"""Dissimilarity nets with more input: which two landmarks a pair is, and the whole view."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import keras
import numpy as np
import tensorflow as tf
import tensorflow.experimental.numpy as tnp
from keras import layers, ops

from deepmds_keras.alignment import normalise
from deepmds_keras.networks import dense_blocks, distance_layers
from deepmds_keras.proximities import VARIANTS, pair_features
from deepmds_keras.training import Recipe, features_and_distances, steps_per_call, train_by_epoch
from deepmds_keras.weights import Stream

_UNITS = 64  # of a hidden layer: with the paper's 20 the pairs would have no room
_EMBEDDED, _CODE = 16, 32
_CHUNK = 8  # faces at a time in use


def build_pair_net(n_landmarks: int, *, whole_view: bool, seed: int = 0) -> keras.Model:
    """The layers of the dissimilarity net on the paper's pair features and more.

    A landmark is an embedding of 16 numbers. The sums and the products of two of them do not
    depend on which comes first.

    Returns:
        Model from features `(P, 6)`, numbers of the landmarks `(P, 2)` and, if it has the whole
        view as an input, too, `(P, 2L)`, to distances `(P, 1)` in the unit of `normalise`.
    """
    dense = dense_blocks(seed)
    initial = keras.initializers.RandomNormal(seed=1000 * seed + 999)
    features = keras.Input((VARIANTS["paper"],), name="pair_features")
    ends = keras.Input((2,), dtype="int32", name="landmarks")
    embedded = layers.Embedding(n_landmarks, _EMBEDDED, initial, name="embedding")(ends)
    inputs = [features, ends]
    known = [features, ops.sum(embedded, 1), ops.prod(embedded, 1)]
    if whole_view:
        view = keras.Input((2 * n_landmarks,), name="view")
        inputs.append(view)
        known.append(dense(dense(view, 2 * _CODE, "view_1"), _CODE, "view_2"))
    distance = distance_layers(dense, layers.Concatenate(name="known")(known), _UNITS)
    name = f"dissimilarity_{n_landmarks}" + "_view" * whole_view
    return keras.Model(inputs, distance, name=name)


@dataclass
class PairNet:
    """Training of such a net, by Adam with a cosine schedule, with shuffled mini-batches.

    Each has as many pairs as a face. Those of one face would not do: what is the same for a whole
    face, such as its view, batch normalisation would take away.
    """

    whole_view: bool
    epochs: int
    steps_per_epoch: int
    seed: int

    def fit(self, frontal, views, shapes, *, checkpoint: Path, progress: Callable) -> keras.Model:
        """Train a net, or go on from a checkpoint.

        Args:
            frontal: `(n, L, 2)` frontal views as the autoencoder predicts them; normalised here.
            views, shapes: `(n, L, 2)` and `(n, L, 3)`, normalised.
            checkpoint: File that is written after every epoch.
            progress: Called after every epoch with its losses.
        """
        (n, n_landmarks), steps, seed = shapes.shape[:2], self.steps_per_epoch, self.seed
        frontal, shapes = np.float32(normalise(frontal)), np.float32(shapes)
        flat_views, pairs = np.float32(views).reshape(n, -1), _pairs(n_landmarks)
        recipe = Recipe(self.epochs, steps, "cosine")
        net = build_pair_net(n_landmarks, whole_view=self.whole_view, seed=seed)
        calls = steps_per_call(steps)
        net.compile(recipe.optimizer(steps), "mse", steps_per_execution=calls, jit_compile=True)

        def batches(epoch: int) -> tf.data.Dataset:
            rng = np.random.default_rng([seed, Stream.SHUFFLED_PAIRS, epoch])
            faces, drawn = (rng.integers(m, size=(steps, len(pairs))) for m in (n, len(pairs)))
            ends = pairs[drawn]
            views, points = (
                tuple(array[faces, ends[..., end]] for end in (0, 1)) for array in (frontal, shapes)
            )

            def batch(faces, ends, views, points):
                features, distances = features_and_distances(views, points, "paper", tnp)
                # Repeated only now: of an epoch they would fill the memory.
                whole = (tf.gather(flat_views, faces),) if self.whole_view else ()
                return (features, ends, *whole), distances

            data = tf.data.Dataset.from_tensor_slices((faces, ends, views, points))
            return data.map(batch).prefetch(2)

        label = {"network": net.name, "seed": seed, "faces": n, **asdict(recipe)}
        train_by_epoch(
            net, batches, label, lambda: net.history.history["loss"][0], checkpoint, progress
        )
        return net


def dissimilarities(net: keras.Model, frontal: np.ndarray, views: np.ndarray) -> np.ndarray:
    """Matrices `(n, L, L)` of the distances that a net predicts, with a diagonal of 0.

    Of `build_pair_net`, or of the method; `views` are normalised, `frontal` are here.
    """
    frontal, views = np.float32(normalise(frontal)), np.float32(views).reshape(len(views), -1)
    n_landmarks, pairs = frontal.shape[1], _pairs(frontal.shape[1])
    matrices = np.zeros((len(frontal), n_landmarks, n_landmarks), np.float32)
    for start in range(0, len(frontal), _CHUNK):
        part = slice(start, start + _CHUNK)
        features = pair_features(frontal[part])
        n = len(features)
        inputs = [features.reshape(n * len(pairs), -1), np.tile(pairs, (n, 1))]
        inputs = [*inputs, np.repeat(views[part], len(pairs), 0)][: len(net.inputs)]
        distances = net(inputs if len(inputs) > 1 else inputs[0], training=False)
        matrices[part, pairs[:, 0], pairs[:, 1]] = np.asarray(distances).reshape(n, -1)
    return matrices + np.swapaxes(matrices, 1, 2)


def _pairs(n_landmarks: int) -> np.ndarray:
    """`(P, 2)` numbers of the landmarks of every pair."""
    return np.stack(np.triu_indices(n_landmarks, 1), 1).astype(np.int32)
