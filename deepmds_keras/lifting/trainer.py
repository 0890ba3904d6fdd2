"""Training of the lifting network in blocks, so that an interrupted run can resume."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import keras
import numpy as np
import tensorflow as tf
from keras import layers, ops

from deepmds_keras.lifting.sampling import Faces
from deepmds_keras.lifting.unrolled_fit import UNIT, lift
from deepmds_keras.training import train_by_epoch

STEPS_PER_BLOCK = 100  # after which the network is checked and a checkpoint is written
# XLA takes half a minute to compile a step that then takes 25 of 50 ms.
_COMPILED_FROM = 2000  # steps
_SHARE_OF_SPREAD = 0.3
_SHARE_OF_SHAPE = 1e5


@dataclass(frozen=True)
class Recipe:
    """Adam with a cosine schedule on clipped gradients.

    Attributes:
        steps: Total number of mini-batches.
        batch_size: Faces per mini-batch.
        learning_rate: Initial learning rate.
    """

    steps: int
    batch_size: int = 128
    learning_rate: float = 2e-3

    @property
    def blocks(self) -> list[int]:
        """Number of steps in each block."""
        whole, left = divmod(self.steps, STEPS_PER_BLOCK)
        return [STEPS_PER_BLOCK] * whole + [left] * (left > 0)


def train_lifting_net(
    initial: dict[str, np.ndarray],
    faces_of_block: Callable[[int, int], Faces],
    held_out: Faces,
    recipe: Recipe,
    *,
    label: dict,
    checkpoint: str | Path | None = None,
    progress: Callable[[dict], object] | None = None,
) -> tuple[dict[str, np.ndarray], dict[str, list[float]]]:
    """Train, and keep the weights that are best on held-out faces.

    Args:
        initial: Weights as from `initial_weights`.
        faces_of_block: From the number of a block and of faces to that many training faces, which
            depend on the numbers alone.
        held_out: Faces that the network is checked on after each block.
        recipe: Steps, batch size and learning rate.
        label: What else identifies the run; the checkpoint of another run is refused.
        checkpoint, progress: As for `train_by_epoch`; a block counts as an epoch.

    Returns:
        The best weights and, by block, the loss `train` during training and the mean squared error
        `inference` on the held-out faces, in the unit of `normalise` squared.

    Raises:
        InputError: The checkpoint is of another run, or damaged.
    """
    model = build_lifting_net(initial)
    network = model.get_layer("lifting")
    schedule = keras.optimizers.schedules.CosineDecay(recipe.learning_rate, recipe.steps)
    optimizer = keras.optimizers.Adam(schedule, global_clipnorm=1.0)
    model.compile(optimizer, lifting_loss, jit_compile=recipe.steps >= _COMPILED_FROM)

    def batches(block: int) -> tf.data.Dataset:
        steps = recipe.blocks[block]
        faces = faces_of_block(block, steps * recipe.batch_size)
        arrays = (faces.views, faces.visible, faces.sd), faces.shapes
        arrays = tf.nest.map_structure(lambda a: a.reshape(steps, -1, *a.shape[1:]), arrays)
        return tf.data.Dataset.from_tensor_slices(arrays)

    def check() -> float:
        weights = {name: weight.numpy() for name, weight in network.arrays.items()}
        error = error_of(weights, held_out)
        if error <= float(network.least_error):
            network.least_error.assign(error)
            for name, array in weights.items():
                network.best[name].assign(array)
        return error

    label = {**label, **asdict(recipe), "epochs": len(recipe.blocks)}
    history = train_by_epoch(model, batches, label, check, checkpoint, progress)
    return {name: weight.numpy() for name, weight in network.best.items()}, history


def error_of(weights, faces: Faces) -> float:
    """Mean squared error of the shapes, computed by NumPy as in use."""
    shapes = lift(np, weights, faces.views, faces.visible, faces.sd).shapes
    return float(np.mean((shapes - faces.shapes) ** 2))


class Lifting(layers.Layer):
    """From views, visibility and the landmarks' errors to shapes and standard deviations.

    Args:
        initial: Weights as from `initial_weights`.

    Attributes:
        arrays: The weights by name.
        best: The best weights so far, with `least_error`, their error: not trained, but part of
            every checkpoint.
    """

    def __init__(self, initial: dict[str, np.ndarray], **options):
        super().__init__(**options)
        self.arrays = {name: self._keep(name, array) for name, array in initial.items()}
        self.best = {name: self._keep(f"best_{name}", initial[name], False) for name in initial}
        self.least_error = self._keep("least_error", np.finfo(np.float32).max, False)

    def _keep(self, name, array, trainable=True):
        return self.add_weight(
            np.shape(array), lambda *_, **__: ops.convert_to_tensor(array), name=name,
            trainable=trainable,
        )  # fmt: skip

    def compute_output_spec(self, views, visible, sd):
        return keras.KerasTensor((None, 6, views.shape[2]), "float32")

    def call(self, views, visible, sd):
        weights = {name: ops.convert_to_tensor(array) for name, array in self.arrays.items()}
        lifted = lift(ops, weights, views, visible, sd, ops.stop_gradient)
        return ops.concatenate([lifted.shapes, lifted.log_sd], 1)


def build_lifting_net(initial: dict[str, np.ndarray]) -> keras.Model:
    """Uncompiled model from views `(n, 2, L)`, visible and sd `(n, L)` to `(n, 6, L)`.

    The output is that of `lift`: shapes, then logarithms of standard deviations.
    """
    n_landmarks = initial["mean"].shape[1]
    shapes = {"views": (2, n_landmarks), "visible": (n_landmarks,), "sd": (n_landmarks,)}
    inputs = [keras.Input(shape, name=name) for name, shape in shapes.items()]
    outputs = Lifting(initial, name="lifting")(*inputs)
    return keras.Model(inputs, outputs, name=f"lifting_{n_landmarks}")


def lifting_loss(truth, output):
    """Squared error of the shapes, and its likelihood under the predicted standard deviations.

    The likelihood takes the error as constant, so that it trains the standard deviations only.
    """
    error = output[:, :3] - truth
    log_sd = output[:, 3:]
    off = ops.stop_gradient(error) / UNIT * ops.exp(-log_sd)
    likelihood = log_sd + off * off / 2
    per_coordinate = _SHARE_OF_SHAPE * error * error + _SHARE_OF_SPREAD * likelihood
    return ops.mean(per_coordinate, axis=(1, 2))
