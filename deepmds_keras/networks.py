"""The two networks of the paper, as uncompiled functional Keras models."""

import logging
import math

import keras
import numpy as np
from keras import layers

from deepmds_keras.errors import check_choice, check_fork
from deepmds_keras.proximities import VARIANTS
from deepmds_keras.validation import check_n_landmarks

check_choice(keras.backend.backend(), "KERAS_BACKEND", ("tensorflow", "jax"))
# A lower precision would change every result without a word.
check_choice(keras.config.dtype_policy().name, "dtype_policy of Keras (keras.json)", ("float32",))
_UNITS = 20  # of each hidden layer of the dissimilarity net
# TensorFlow advises against what it takes for one network traced again and again: it counts the
# networks of a process together.
logging.getLogger("tensorflow").addFilter(
    lambda record: "triggered tf.function retracing" not in record.getMessage()
)


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
    first = 1000 * seed
    view = keras.Input((2 * n_landmarks,), name="view")
    x = dense_block(view, 64, "encode_1", seed=first)
    x = dense_block(x, 32, "encode_2", seed=first + 1)
    x = dense_block(x, 16, "encode_3", seed=first + 2)
    x = dense_block(x, 16, "code", seed=first + 3, normalised=False)
    x = dense_block(x, 32, "decode_1", seed=first + 4)
    x = dense_block(x, 64, "decode_2", seed=first + 5)
    frontal = dense_block(x, 2 * n_landmarks, "frontal", seed=first + 6)
    return keras.Model(view, frontal, name=f"autoencoder_{n_landmarks}")


def build_dissimilarity_net(variant: str = "paper", *, seed: int = 0) -> keras.Model:
    """The five-layer net that estimates the 3D distance of a pair of landmarks.

    Five hidden layers of 20 units with a skip connection, which the released code makes by
    concatenating the second and the fourth; batch normalisation on the scalar output too.

    Args:
        variant: `"paper"` (6 features, 2,443 trainable parameters of 2,645) or `"released"`
            (5 features, 2,423 of 2,625); see `pair_features`.
        seed: Seed of the initial weights.

    Returns:
        Model from `(P, F)` features to `(P, 1)` distances in the unit of `normalise`.

    Raises:
        InputError: Unknown variant.
    """
    check_choice(variant, "variant", VARIANTS)
    pair = keras.Input((VARIANTS[variant],), name="pair_features")
    distance = distance_layers(pair, _UNITS, seed=1000 * seed)
    return keras.Model(pair, distance, name=f"dissimilarity_{variant}")


def distance_layers(pair: keras.KerasTensor, units: int, *, seed: int) -> keras.KerasTensor:
    """Layers of the dissimilarity net: from `(P, F)` features of pairs to distances, `(P, 1)`."""
    x = dense_block(pair, units, "hidden_1", seed=seed)
    second = dense_block(x, units, "hidden_2", seed=seed + 1)
    x = dense_block(second, units, "hidden_3", seed=seed + 2)
    x = dense_block(x, units, "hidden_4", seed=seed + 3)
    x = layers.Concatenate(name="skip_connection")([second, x])
    x = dense_block(x, units, "hidden_5", seed=seed + 4)
    return dense_block(x, 1, "distance", seed=seed + 5, activated=False)


def dense_block(
    x: keras.KerasTensor,
    units: int,
    name: str,
    *,
    seed: int,
    activated: bool = True,
    normalised: bool = True,
) -> keras.KerasTensor:
    """The trio of both networks: dense, LeakyReLU, batch normalisation; `seed` is of the kernel."""
    check_fork("Keras")
    x = layers.Dense(int(units), kernel_initializer=glorot(seed), name=name)(x)
    if activated:
        x = layers.LeakyReLU(negative_slope=0.3, name=f"{name}_lrelu")(x)
    if normalised:
        x = layers.BatchNormalization(name=f"{name}_bn")(x)
    return x


def glorot(seed: int) -> keras.Initializer:
    """Keras's default for kernels. Of integers Keras takes Python's alone, hence `int` here."""
    return keras.initializers.GlorotUniform(seed=int(seed))


def count_trainable(*networks: keras.Model) -> int:
    """Total number of trainable parameters of the networks."""
    return sum(math.prod(weight.shape) for net in networks for weight in net.trainable_weights)


def forward(network: keras.Model, inputs: np.ndarray, batch_size: int = 1 << 15) -> np.ndarray:
    """Outputs `(n, d_out)` float32 of a network in inference mode.

    `Model.predict` would prepare a data pipeline, which takes longer than a few faces.

    Args:
        network: Model with one input and one output.
        inputs: `(n, …)`.
        batch_size: Rows at a time, which bounds the memory.

    Raises:
        InputError: In a fork of a process that has used Keras.
    """
    check_fork("Keras")
    batches = range(0, len(inputs), batch_size)
    outputs = [network.predict_on_batch(inputs[i : i + batch_size]) for i in batches]
    return np.concatenate(outputs)
