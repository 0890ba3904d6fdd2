"""The two networks of the paper, as uncompiled functional Keras models."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import keras
import numpy as np
import tensorflow as tf
from keras import layers

from deepmds_keras.errors import check_choice
from deepmds_keras.proximities import VARIANTS
from deepmds_keras.validation import check_n_landmarks


def build_autoencoder(n_landmarks: int = 72, *, seed: int = 0) -> keras.Model:
    """Autoencoder that maps any view of a face to the frontal one (the paper's "profile").

    Seven dense layers 64-32-16-16-32-64-2L, each followed by LeakyReLU and batch normalisation,
    the output included. The fourth is not normalised: the released code creates that layer but
    leaves it unconnected, and the released weights have no entry for it.

    Args:
        n_landmarks: L. 72 gives 24,880 trainable parameters of 25,584, 51 gives 19,378 of 19,998.
        seed: Seed of the initial weights.

    Returns:
        Model from `(n, 2L)` coordinates x1, y1, x2, … to `(n, 2L)`.

    Raises:
        InputError: The number of landmarks is not whole, or below 3.
    """
    check_n_landmarks(n_landmarks)
    dense = dense_blocks(seed)
    view = keras.Input((2 * n_landmarks,), name="view")
    x = dense(dense(dense(view, 64, "encode_1"), 32, "encode_2"), 16, "encode_3")
    x = dense(x, 16, "code", normalised=False)
    x = dense(dense(x, 32, "decode_1"), 64, "decode_2")
    frontal = dense(x, 2 * n_landmarks, "frontal")
    return keras.Model(view, frontal, name=f"autoencoder_{n_landmarks}")


def build_dissimilarity_net(
    variant: str = "paper", *, seed: int = 0, chain: tuple[int, int] | None = None
) -> keras.Model:
    """The five-layer net that estimates the 3D distance of a pair of landmarks.

    Five hidden layers of 20 units with a skip connection, which the released code makes by
    concatenating the second and the fourth; batch normalisation on the scalar output too.

    Args:
        variant: `"paper"` (6 features, 2,443 trainable parameters of 2,645) or `"released"`
            (5 features, 2,423 of 2,625); see `pair_features`.
        seed: Seed of the initial weights.
        chain: Number of hidden layers and units per layer of a net without skip connection, to
            compare with the paper's; None builds the paper's.

    Returns:
        Model from `(P, F)` features to `(P, 1)` distances in the unit of `normalise`.

    Raises:
        InputError: Unknown variant.
    """
    check_choice(variant, "variant", VARIANTS)
    pair = keras.Input((VARIANTS[variant],), name="pair_features")
    dense, name = dense_blocks(seed), f"dissimilarity_{variant}"
    if chain is None:
        return keras.Model(pair, distance_layers(dense, pair, 20), name=name)
    x, (n_layers, units) = pair, chain
    for k in range(1, n_layers + 1):
        x = dense(x, units, f"hidden_{k}")
    distance = dense(x, 1, "distance", activated=False)
    return keras.Model(pair, distance, name=f"{name}_chain_{n_layers}x{units}")


def distance_layers(dense: Callable, pair: keras.KerasTensor, units: int) -> keras.KerasTensor:
    """Layers of the dissimilarity net: from `(P, F)` features of pairs to distances, `(P, 1)`."""
    x = dense(pair, units, "hidden_1")
    second = x = dense(x, units, "hidden_2")
    x = dense(x, units, "hidden_3")
    x = dense(x, units, "hidden_4")
    x = layers.Concatenate(name="skip_connection")([second, x])
    x = dense(x, units, "hidden_5")
    return dense(x, 1, "distance", activated=False)


def count_trainable(*networks: keras.Model) -> int:
    """Total number of trainable parameters of the networks."""
    return sum(math.prod(weight.shape) for net in networks for weight in net.trainable_weights)


def forward(network: Callable, inputs: np.ndarray, batch_size: int = 1 << 15) -> np.ndarray:
    """Outputs `(n, d_out)` float32 of a network in inference mode.

    A single batch goes through the network directly; for more, a graph is traced once for each
    network, with the same outputs in half the time. `Model.predict` would also trace one for every
    new shape, and wait for its data pipeline.

    Args:
        network: Model with one input and one output, or a function with the same signature.
        inputs: `(n, …)`.
        batch_size: Rows at a time, which bounds the memory.
    """
    outputs = functools.partial(network, training=False)
    if len(inputs) > batch_size and isinstance(network, keras.Model):
        if not hasattr(network, "inference_graph"):
            rows = tf.TensorSpec((None, *network.input_shape[1:]), tf.float32)
            network.inference_graph = tf.function(outputs, input_signature=[rows])
        outputs, inputs = network.inference_graph, np.asarray(inputs, np.float32)
    batches = range(0, len(inputs), batch_size)
    return np.concatenate([np.asarray(outputs(inputs[i : i + batch_size])) for i in batches])


def dense_blocks(seed: int) -> Callable:
    """The repeated trio dense → LeakyReLU → batch normalisation, each layer seeded in turn."""
    seeds = iter(range(1000 * seed, 1000 * seed + 1000))

    def dense(x, units: int, name: str, *, activated: bool = True, normalised: bool = True):
        initial = keras.initializers.GlorotUniform(seed=next(seeds))
        x = layers.Dense(units, kernel_initializer=initial, name=name)(x)
        if activated:
            x = layers.LeakyReLU(negative_slope=0.3, name=f"{name}_lrelu")(x)
        if normalised:
            x = layers.BatchNormalization(name=f"{name}_bn")(x)
        return x

    return dense
