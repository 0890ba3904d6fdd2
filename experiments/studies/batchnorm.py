"""Batch normalisation with its statistics estimated anew: what the moving ones cost a network."""

from __future__ import annotations

import keras
import numpy as np


def recalibrate_batchnorm(network: keras.Model, inputs: np.ndarray) -> keras.Model:
    """The same weights with the batch normalisation of these inputs, all as one batch.

    Training leaves in each such layer a moving average of the statistics of past mini-batches,
    seen by past weights. What a network gains by this is what their lag cost it.

    Args:
        network: Trained model; it is not changed.
        inputs: `(n, d)`, the faces it was trained on.
    """
    copy = keras.models.clone_model(network)
    copy.set_weights(network.get_weights())
    for layer in copy.layers:
        if isinstance(layer, keras.layers.BatchNormalization):
            layer.momentum = 0.0  # nothing of the old average is kept
    copy(inputs, training=True)
    return copy
