"""The lifting network as a Keras model, to train it."""

from __future__ import annotations

import keras
import numpy as np
from keras import layers, ops

from deepmds_keras.lifting.network import UNIT, lift

_SHARE_OF_SPREAD = 0.3
_SHARE_OF_SHAPE = 1e5


class Lifting(layers.Layer):
    """Views, what of them is visible and the landmarks' errors in, shapes and their spread out.

    Args:
        initial: Weights as from `initial_weights`.
        iterations: Of a `Size`.
    """

    def __init__(self, initial: dict[str, np.ndarray], iterations: tuple[int, ...], **options):
        super().__init__(**options)
        self.iterations = iterations
        self.arrays = {
            name: self.add_weight(
                shape=array.shape, initializer=lambda *_, array=array, **__: array, name=name
            )
            for name, array in initial.items()
        }

    def compute_output_spec(self, views, visible, sd):
        return keras.KerasTensor((None, 6, views.shape[2]), "float32")

    def call(self, views, visible, sd):
        weights = {name: ops.convert_to_tensor(array) for name, array in self.arrays.items()}
        lifted = lift(ops, weights, self.iterations, views, visible, sd, ops.stop_gradient)
        return ops.concatenate([lifted.shapes, lifted.log_sd], 1)


def build_lifting_net(initial: dict[str, np.ndarray], iterations: tuple[int, ...]) -> keras.Model:
    """Uncompiled model from views `(n, 2, L)`, visible and sd `(n, L)` to `(n, 6, L)`.

    The output is that of `lift`, shapes over logarithms of standard deviations.
    """
    n_landmarks = initial["mean"].shape[1]
    inputs = [
        keras.Input((2, n_landmarks), name="views"),
        keras.Input((n_landmarks,), name="visible"),
        keras.Input((n_landmarks,), name="sd"),
    ]
    outputs = Lifting(initial, iterations, name="lifting")(*inputs)
    return keras.Model(inputs, outputs, name=f"lifting_{n_landmarks}")


def lifting_loss(truth, output):
    """Squared error of the shapes, and likelihood of it under the predicted spread.

    The likelihood sees the error as given, so that spread is learnt and no shape is changed by it.
    """
    error = output[:, :3] - truth
    log_sd = output[:, 3:]
    off = ops.stop_gradient(error) / UNIT * ops.exp(-log_sd)
    likelihood = log_sd + off * off / 2
    per_coordinate = _SHARE_OF_SHAPE * error * error + _SHARE_OF_SPREAD * likelihood
    return ops.mean(per_coordinate, axis=(1, 2))
