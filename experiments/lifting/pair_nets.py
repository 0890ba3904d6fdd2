"""Dissimilarity nets that are told more: which two landmarks a pair is, and the whole view."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import keras
import numpy as np
import tensorflow as tf
import tensorflow.experimental.numpy as tnp
from keras import layers, ops

from deepmds_keras.networks import dense_blocks, distance_layers
from deepmds_keras.normalisation import normalise
from deepmds_keras.proximities import VARIANTS, pair_features
from deepmds_keras.streams import Stream
from deepmds_keras.training import (
    Recipe,
    features_and_distances,
    steps_per_call,
    train_by_epoch,
)

_UNITS = 64  # of a hidden layer: with the paper's 20 the pairs would have no room
_EMBEDDED, _CODE = 16, 32
_CHECK_FACES = 50
_CHUNK = 8  # faces at a time in use


def build_pair_net(n_landmarks: int, *, whole_view: bool, seed: int = 0) -> keras.Model:
    """The layers of the dissimilarity net on the paper's pair features and more.

    A landmark is an embedding of 16 numbers. The sums and the products of two of them do not
    depend on which comes first.

    Args:
        n_landmarks: L.
        whole_view: Whether it also sees a code of 32 numbers of all landmarks of the view.
        seed: Of the initial weights.

    Returns:
        Model from features `(P, 6)`, numbers of the landmarks `(P, 2)` and, of the whole view,
        `(P, 2L)`, to distances `(P, 1)` in the unit of `normalise`.
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


def train_pair_net(
    frontal: np.ndarray,
    views: np.ndarray,
    shapes: np.ndarray,
    recipe: Recipe,
    *,
    whole_view: bool,
    seed: int = 0,
    checkpoint: str | Path | None = None,
    progress: Callable[[dict], object] | None = None,
) -> keras.Model:
    """Train as `train_dissimilarity_net` does with shuffled mini-batches.

    Mini-batches of one face would not do: what is the same for a whole face, such as its view,
    batch normalisation would take away.

    Args:
        frontal: `(n, L, 2)` frontal views as the autoencoder predicts them; normalised here.
        views: `(n, L, 2)` normalised views as they were given.
        shapes: `(n, L, 3)` normalised shapes, whose distances are the targets.
        recipe: Epochs, steps in an epoch, of as many pairs each as a face has, and learning rate.
        whole_view: As for `build_pair_net`.
        seed: Of the initial weights and of the pairs.
        checkpoint: File to go on from, and to write after every epoch.
        progress: Called after every epoch with its losses.
    """
    n, n_landmarks = shapes.shape[:2]
    frontal, shapes = np.float32(normalise(frontal)), np.float32(shapes)
    flat_views = np.float32(views).reshape(n, -1)
    pairs = np.stack(np.triu_indices(n_landmarks, 1), 1).astype(np.int32)
    steps = recipe.steps_per_epoch or n
    model = build_pair_net(n_landmarks, whole_view=whole_view, seed=seed)
    model.compile(
        recipe.optimizer(steps),
        "mse",
        steps_per_execution=steps_per_call(steps),
        jit_compile=True,
    )

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
            seen = (tf.gather(flat_views, faces),) if whole_view else ()
            return (features, ends, *seen), distances

        data = tf.data.Dataset.from_tensor_slices((faces, ends, views, points))
        return data.map(batch).prefetch(2)

    check = slice(min(n, _CHECK_FACES))
    check_points = shapes[check]
    check_distances = np.linalg.norm(
        check_points[:, pairs[:, 0]] - check_points[:, pairs[:, 1]], axis=2
    )

    def inference() -> float:
        predicted = _distances(model, frontal[check], flat_views[check], pairs)
        return float(np.mean((predicted - check_distances) ** 2))

    label = {"network": model.name, "seed": seed, "faces": n, **asdict(recipe)}
    train_by_epoch(model, batches, label, inference, checkpoint, progress)
    return model


def net_dissimilarities(model: keras.Model, frontal: np.ndarray, views: np.ndarray) -> np.ndarray:
    """Matrices `(n, L, L)` of the distances that the net finds, with a diagonal of 0.

    Args:
        model: As from `train_pair_net`, or the dissimilarity net of the method.
        frontal: `(n, L, 2)` frontal views; normalised here.
        views: `(n, L, 2)` normalised views as they were given.
    """
    n, n_landmarks = frontal.shape[:2]
    first, second = np.triu_indices(n_landmarks, 1)
    flat_views = np.float32(views).reshape(n, -1)
    pairs = np.stack([first, second], 1).astype(np.int32)
    distances = _distances(model, np.float32(normalise(frontal)), flat_views, pairs)
    matrices = np.zeros((n, n_landmarks, n_landmarks), np.float32)
    matrices[:, first, second] = matrices[:, second, first] = distances
    return matrices


def _distances(model, frontal, flat_views, pairs) -> np.ndarray:
    """Distances `(n, P)` of all pairs of faces, in inference mode, of what the net takes."""
    found = []
    for start in range(0, len(frontal), _CHUNK):
        chunk = slice(start, start + _CHUNK)
        features = pair_features(frontal[chunk])
        n = len(features)
        inputs = [
            features.reshape(n * len(pairs), -1),
            np.tile(pairs, (n, 1)),
            np.repeat(flat_views[chunk], len(pairs), 0),
        ][: len(model.inputs)]
        distances = model(inputs if len(inputs) > 1 else inputs[0], training=False)
        found.append(np.asarray(distances).reshape(n, -1))
    return np.concatenate(found)
