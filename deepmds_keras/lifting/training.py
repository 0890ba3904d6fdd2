"""Training of the lifting network, block by block, so that a stopped run goes on where it was."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import keras
import numpy as np
import tensorflow as tf
from keras import layers, ops

from deepmds_keras.errors import InputError
from deepmds_keras.lifting.faces import Faces
from deepmds_keras.lifting.network import UNIT, lift
from deepmds_keras.training import untuned
from deepmds_keras.weights import read_arrays, write_arrays

STEPS_PER_BLOCK = 100  # after which the network is checked and a checkpoint is written
# XLA takes half a minute to compile a step that then takes 25 of 50 ms.
_COMPILED_FROM = 2000  # steps
_SHARE_OF_SPREAD = 0.3
_SHARE_OF_SHAPE = 1e5


@dataclass(frozen=True)
class Recipe:
    """Adam with a cosine schedule on clipped gradients.

    Attributes:
        steps: Mini-batches in all.
        batch_size: Faces in a mini-batch.
        learning_rate: At the start.
    """

    steps: int
    batch_size: int = 128
    learning_rate: float = 2e-3

    @property
    def blocks(self) -> list[int]:
        """Number of steps of each block."""
        whole, left = divmod(self.steps, STEPS_PER_BLOCK)
        return [STEPS_PER_BLOCK] * whole + [left] * (left > 0)


def train_lifting_net(
    initial: dict[str, np.ndarray],
    iterations: tuple[int, ...],
    faces_of_block: Callable[[int, int], Faces],
    held_out: Faces,
    recipe: Recipe,
    *,
    label: dict,
    checkpoint: str | Path | None = None,
    progress: Callable[[dict], object] | None = None,
) -> tuple[dict[str, np.ndarray], dict[str, list[float]]]:
    """Train, and keep the weights that were best on faces held out.

    Args:
        initial: Weights as from `initial_weights`.
        iterations: Of the `Size`.
        faces_of_block: From the number of a block and of faces to that many training faces, which
            depend on the numbers alone.
        held_out: Faces that the network is checked on after each block.
        recipe: Steps, batch size and learning rate.
        label: What else identifies the run; the checkpoint of another run is refused.
        checkpoint: File to go on from, and to write after every block.
        progress: Called after every block with its losses.

    Returns:
        The best weights, and by block the loss `train` while the weights changed and the mean
        squared error `held_out`, in the unit of `normalise` squared.

    Raises:
        InputError: The checkpoint is of another run, or damaged.
    """
    model = build_lifting_net(initial, iterations)
    schedule = keras.optimizers.schedules.CosineDecay(recipe.learning_rate, recipe.steps)
    optimizer = keras.optimizers.Adam(schedule, global_clipnorm=1.0)
    model.compile(optimizer, lifting_loss, jit_compile=recipe.steps >= _COMPILED_FROM)
    optimizer.build(model.trainable_variables)
    label = {**label, **asdict(recipe), "weights": {k: list(a.shape) for k, a in initial.items()}}
    history = {"train": [], "held_out": []}
    best = initial
    if checkpoint is not None and os.path.exists(checkpoint):
        best, history = _read(checkpoint, model, initial, label)
        for block in range(len(history["train"])):
            _report(progress, history, block)
    for block in range(len(history["train"]), len(recipe.blocks)):
        steps = recipe.blocks[block]
        faces = faces_of_block(block, steps * recipe.batch_size)
        fitted = model.fit(untuned(_batches(faces, steps)), shuffle=False, verbose=0)
        error = _error(_weights(model), iterations, held_out)
        history["train"].append(float(fitted.history["loss"][0]))
        history["held_out"].append(error)
        if error <= np.nanmin(history["held_out"]):
            best = _weights(model)
        if checkpoint is not None:
            _write(checkpoint, model, best, {"label": label, "history": history})
        _report(progress, history, block)
    return best, history


def _batches(faces: Faces, steps: int) -> tf.data.Dataset:
    arrays = (faces.views, faces.visible, faces.sd), faces.shapes
    batches = tf.nest.map_structure(lambda a: a.reshape(steps, -1, *a.shape[1:]), arrays)
    return tf.data.Dataset.from_tensor_slices(batches)


def _error(weights, iterations, faces: Faces) -> float:
    """Mean squared error of the shapes, as they are used: by NumPy."""
    shapes = lift(np, weights, iterations, faces.views, faces.visible, faces.sd).shapes
    return float(np.mean((shapes - faces.shapes) ** 2))


def _weights(model) -> dict[str, np.ndarray]:
    return {weight.name: weight.numpy() for weight in model.trainable_variables}


def _write(path, model, best, description):
    arrays = {f"now/{name}": array for name, array in _weights(model).items()}
    arrays |= {f"best/{name}": array for name, array in best.items()}
    arrays |= {f"optimizer/{i}": v.numpy() for i, v in enumerate(model.optimizer.variables)}
    write_arrays(path, arrays, description, compressed=False)


def _read(path, model, initial, label):
    arrays, description = read_arrays(path)
    if description.get("label") != label:
        raise InputError(
            f"{path} is of another run; delete it to train anew. "
            f"Received {description.get('label')}, needed {label}."
        )
    variables = {f"now/{v.name}": v for v in model.trainable_variables}
    variables |= {f"optimizer/{i}": v for i, v in enumerate(model.optimizer.variables)}
    needed = {name: tuple(v.shape) for name, v in variables.items()}
    needed |= {f"best/{name}": array.shape for name, array in initial.items()}
    if {name: array.shape for name, array in arrays.items()} != needed:
        raise InputError(f"{path} does not hold what a checkpoint does; delete it to train anew.")
    for name, variable in variables.items():
        variable.assign(arrays[name])
    best = {name: arrays[f"best/{name}"] for name in initial}
    return best, description["history"]


def _report(progress, history, block):
    if progress is not None:
        progress({name: losses[block] for name, losses in history.items()})


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
