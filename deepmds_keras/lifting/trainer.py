"""Training of the lifting network in blocks, so that an interrupted run can resume."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import keras
import numpy as np
from keras import layers, ops

from deepmds_keras.errors import check_fork
from deepmds_keras.lifting.sampling import Faces
from deepmds_keras.lifting.unrolled_fit import UNIT, lift
from deepmds_keras.training import train_by_epoch

STEPS_PER_BLOCK = 100  # after which the network is checked and a checkpoint is written
# XLA takes half a minute to compile a step that then takes 25 of 50 ms.
_COMPILED_FROM = 2000  # steps
_SHARE_OF_SPREAD = 0.3
_SHARE_OF_SHAPE = 1e5


def train_lifting_net(
    initial: dict[str, np.ndarray],
    faces_of_block: Callable[[int, int], Faces],
    held_out: Faces,
    *,
    steps: int,
    batch_size: int,
    learning_rate: float,
    label: dict,
    checkpoint: str | Path | None = None,
    progress: Callable[[dict], object] | None = None,
) -> tuple[dict[str, np.ndarray], dict[str, list[float]]]:
    """Train with Adam, clipped gradients and a cosine schedule; keep the best weights.

    Args:
        initial: Weights as from `initial_weights`.
        faces_of_block: From the number of a block and of faces to that many training faces, which
            depend on the numbers alone.
        held_out: Faces that the network is checked on after each block.
        label: What identifies the run; the checkpoint of another run is refused.
        checkpoint, progress: As for `train_by_epoch`; a block counts as an epoch.

    Returns:
        The weights that are best on the held-out faces and, by block, the loss `train` during
        training and the mean squared error `inference` on the held-out faces, in the unit of
        `normalise` squared.

    Raises:
        InputError: The checkpoint is of another run, or damaged.
    """
    model = build_lifting_net(initial)
    network = model.get_layer("lifting")
    schedule = keras.optimizers.schedules.CosineDecay(learning_rate, steps)
    optimizer = keras.optimizers.Adam(schedule, global_clipnorm=1.0)
    # Uncompiled, JAX would run each operation of a step by itself.
    compiled = steps >= _COMPILED_FROM or keras.backend.backend() == "jax"
    model.compile(optimizer, lifting_loss, jit_compile=compiled)
    blocks = block_sizes(steps)

    def mini_batches(block: int) -> dict[str, Any]:
        # A whole block each time, so that a shorter last one continues where the others stopped.
        faces = faces_of_block(block, blocks[0] * batch_size)[: blocks[block] * batch_size]
        inputs = [faces.views, faces.visible, faces.sd]
        return {"x": inputs, "y": faces.shapes, "batch_size": batch_size}

    def check() -> float:
        weights = {name: weight.numpy() for name, weight in network.arrays.items()}
        error = error_of(weights, held_out)
        if error <= float(network.least_error.numpy()):
            network.least_error.assign(error)
            for name, array in weights.items():
                network.best[name].assign(array)
        return error

    label = {**label, "epochs": len(blocks)}
    history = train_by_epoch(model, mini_batches, label, check, checkpoint, progress)
    return {name: weight.numpy() for name, weight in network.best.items()}, history


def block_sizes(steps: int) -> list[int]:
    """Number of steps in each block."""
    whole, left = divmod(steps, STEPS_PER_BLOCK)
    return [STEPS_PER_BLOCK] * whole + ([left] if left else [])


def error_of(weights, faces: Faces) -> float:
    """Mean squared error of the shapes, computed by NumPy as in use."""
    shapes = lift(np, weights, faces.views, faces.visible, faces.sd).shapes
    return float(np.mean((shapes - faces.shapes) ** 2))


class Lifting(layers.Layer):
    """From views, visibility and the landmarks' noise to shapes and standard deviations.

    Args:
        shapes: Shape of each weight, by its name in `initial_weights`.

    Attributes:
        arrays: The weights by name.
        best: The best weights so far, with `least_error`, their error: not trained, but part of
            every checkpoint.
    """

    def __init__(self, shapes: dict[str, tuple[int, ...]], **options):
        super().__init__(**options)
        self.arrays, self.best = (
            {
                name: self.add_weight(shape, "zeros", name=f"{prefix}{name}", trainable=not prefix)
                for name, shape in shapes.items()
            }
            for prefix in ("", "best_")
        )
        largest = keras.initializers.Constant(np.finfo(np.float32).max)
        self.least_error = self.add_weight((), largest, name="least_error", trainable=False)

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
    check_fork("Keras")
    n_landmarks = initial["mean"].shape[1]
    views = keras.Input((2, n_landmarks), name="views")
    visible = keras.Input((n_landmarks,), name="visible")
    sd = keras.Input((n_landmarks,), name="sd")
    layer = Lifting({name: array.shape for name, array in initial.items()}, name="lifting")
    model = keras.Model([views, visible, sd], layer(views, visible, sd), name="lifting")
    for name, array in initial.items():
        layer.arrays[name].assign(array)
        layer.best[name].assign(array)
    return model


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
