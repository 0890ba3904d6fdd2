"""Dissimilarity nets of a `Variant`: building, training, and predicting all distances."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import keras
import numpy as np
import tensorflow as tf
import tensorflow.experimental.numpy as tnp
from keras import layers, ops

from deepmds_keras.networks import dense_blocks, distance_layers
from deepmds_keras.proximities import VARIANTS as N_FEATURES
from deepmds_keras.proximities import pair_features
from deepmds_keras.streams import Stream
from deepmds_keras.training import (
    Recipe,
    face_order,
    features_and_distances,
    steps_per_call,
    train_by_epoch,
)
from experiments.lifting.variants import Variant

_EMBEDDED, _CODE = 16, 32
_CHUNK = 8  # faces at a time in use
_AHEAD = 50  # mini-batches that are made while the net trains


def build_pair_net(n_landmarks: int, variant: Variant, *, seed: int = 0) -> keras.Model:
    """The layers of the dissimilarity net on the paper's pair features and more.

    Each landmark has an embedding of 16 numbers. Sums and products of two embeddings do not depend
    on their order.

    Returns:
        Model from features `(P, 6)` and, if the variant has them, numbers of the landmarks `(P, 2)`
        and the whole view `(P, 2L)`, to distances `(P, 1)` in the unit of `normalise`.
    """
    dense = dense_blocks(seed)
    features = keras.Input((N_FEATURES["paper"],), name="pair_features")
    inputs, known = [features], [features]
    if variant.identity:
        ends = keras.Input((2,), dtype="int32", name="landmarks")
        initial = keras.initializers.RandomNormal(seed=1000 * seed + 999)
        embedded = layers.Embedding(n_landmarks, _EMBEDDED, initial, name="embedding")(ends)
        inputs.append(ends)
        known += [ops.sum(embedded, 1), ops.prod(embedded, 1)]
    if variant.whole_view:
        view = keras.Input((2 * n_landmarks,), name="view")
        inputs.append(view)
        known.append(dense(dense(view, 2 * _CODE, "view_1"), _CODE, "view_2"))
    joined = layers.Concatenate(name="known")(known) if len(known) > 1 else features
    distance = distance_layers(dense, joined, variant.units)
    inputs = inputs if len(inputs) > 1 else features
    return keras.Model(inputs, distance, name=f"dissimilarity_{n_landmarks}")


@dataclass
class PairNet:
    """Training of such a net by Adam."""

    variant: Variant
    epochs: int
    steps_per_epoch: int
    seed: int

    def fit(self, frontal, views, shapes, *, checkpoint: Path, progress: Callable) -> keras.Model:
        """Train a net, or resume from a checkpoint.

        Args:
            frontal: `(n, L, 2)` views whose pairs are used.
            views, shapes: `(n, L, 2)` and `(n, L, 3)`, normalised.
            checkpoint: File that is written after every epoch.
            progress: Called after every epoch with its losses.
        """
        (n, n_landmarks), steps, seed = shapes.shape[:2], self.steps_per_epoch, self.seed
        frontal, shapes, variant = np.float32(frontal), np.float32(shapes), self.variant
        flat_views, pairs = np.float32(views).reshape(n, -1), _pairs(n_landmarks)
        recipe = Recipe(self.epochs, steps, variant.schedule)
        net = build_pair_net(n_landmarks, variant, seed=seed)
        calls = steps_per_call(steps)
        net.compile(recipe.optimizer(steps), "mse", steps_per_execution=calls, jit_compile=True)

        def batches(epoch: int) -> tf.data.Dataset:
            if variant.shuffled:
                rng = np.random.default_rng([seed, Stream.SHUFFLED_PAIRS, epoch])
                faces, drawn = (rng.integers(m, size=(steps, len(pairs))) for m in (n, len(pairs)))
            else:
                faces = face_order(n, steps, seed, epoch)[:, None]
                drawn = np.tile(np.arange(len(pairs)), (steps, 1))

            def batch(faces, drawn):
                # Gathered late: all pairs of an epoch would fill the memory.
                faces, ends = tf.broadcast_to(faces, tf.shape(drawn)), tf.gather(pairs, drawn)
                places = tf.stack([tf.stack([faces, faces], 1), tf.cast(ends, faces.dtype)], -1)
                views, points = (
                    tf.unstack(tf.gather_nd(array, places), axis=1) for array in (frontal, shapes)
                )
                features, distances = features_and_distances(views, points, "paper", tnp)
                known = (ends,) if variant.identity else ()
                whole = (tf.gather(flat_views, faces),) if variant.whole_view else ()
                seen = (features, *known, *whole)
                return (seen if len(seen) > 1 else features), distances

            data = tf.data.Dataset.from_tensor_slices((faces, drawn))
            return data.map(batch).prefetch(_AHEAD)

        label = {"network": net.name, "seed": seed, "faces": n, **asdict(recipe)}
        train_by_epoch(
            net, batches, label, lambda: net.history.history["loss"][0], checkpoint, progress
        )
        return net


def dissimilarities(net: keras.Model, frontal: np.ndarray, views: np.ndarray) -> np.ndarray:
    """Matrices `(n, L, L)` of the distances that a net predicts, with zero diagonal.

    The net is one of `build_pair_net`, or the method's; pairs come from `frontal`, `views` are
    whole.
    """
    frontal, views = np.float32(frontal), np.float32(views).reshape(len(views), -1)
    n_landmarks, pairs = frontal.shape[1], _pairs(frontal.shape[1])
    matrices = np.zeros((len(frontal), n_landmarks, n_landmarks), np.float32)
    for start in range(0, len(frontal), _CHUNK):
        part = slice(start, start + _CHUNK)
        features = pair_features(frontal[part])
        n = len(features)
        flat = features.reshape(n * len(pairs), -1)
        inputs = [flat, np.tile(pairs, (n, 1)), np.repeat(views[part], len(pairs), 0)]
        inputs = inputs[: len(net.inputs)]
        distances = net(inputs if len(inputs) > 1 else flat, training=False)
        matrices[part, pairs[:, 0], pairs[:, 1]] = np.asarray(distances).reshape(n, -1)
    return matrices + np.swapaxes(matrices, 1, 2)


def _pairs(n_landmarks: int) -> np.ndarray:
    """`(P, 2)` numbers of the landmarks of every pair."""
    return np.stack(np.triu_indices(n_landmarks, 1), 1).astype(np.int32)
