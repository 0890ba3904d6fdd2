"""Dissimilarity nets that know more of a pair than the paper's."""

import keras
from keras import layers, ops

from deepmds_keras.networks import dense_block, distance_layers
from deepmds_keras.proximities import VARIANTS as N_FEATURES
from experiments.lifting.variants import Variant

_EMBEDDED, _CODE = 16, 32


def build_pair_net(n_landmarks: int, variant: Variant, *, seed: int = 0) -> keras.Model:
    """The layers of the dissimilarity net on the paper's pair features and more.

    Each landmark has an embedding of 16 numbers. Sums and products of two embeddings do not depend
    on their order.

    Returns:
        Model from features `(P, 6)` and, if the variant has them, numbers of the landmarks `(P, 2)`
        and the whole view `(P, 2L)`, to distances `(P, 1)` in the unit of `normalise`.
    """
    first = 1000 * seed
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
        x = dense_block(view, 2 * _CODE, "view_1", seed=first)
        known.append(dense_block(x, _CODE, "view_2", seed=first + 1))
        first += 2
    joined = layers.Concatenate(name="known")(known) if len(known) > 1 else features
    distance = distance_layers(joined, variant.units, seed=first)
    inputs = inputs if len(inputs) > 1 else features
    return keras.Model(inputs, distance, name=f"dissimilarity_{n_landmarks}")
