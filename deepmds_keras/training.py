"""Training of the two networks, epoch by epoch, so that a stopped run goes on where it was."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import keras
import numpy as np
import tensorflow as tf
import tensorflow.experimental.numpy as tnp

from deepmds_keras.errors import InputError, check_choice
from deepmds_keras.files import read_arrays
from deepmds_keras.geometry.units import normalise
from deepmds_keras.networks import build_autoencoder, build_dissimilarity_net, forward
from deepmds_keras.proximities import proximities
from deepmds_keras.streams import Stream
from deepmds_keras.weights import read_checkpoint, set_network_arrays, write_checkpoint

_STEPS_PER_CALL = 50  # steps of the optimiser within one call of the compiled graph
_DISSIMILARITY_CHECK_FACES = 50


@dataclass(frozen=True)
class Recipe:
    """Recipe of a network's training: Adam on the mean squared error.

    Attributes:
        epochs: Of `steps_per_epoch` mini-batches; a checkpoint is written after each.
        steps_per_epoch: Mini-batches in an epoch, or None for all of the data.
        schedule: `"constant"` learning rate (the paper and its code) or `"cosine"` decay to zero.
        learning_rate: Adam's initial learning rate.
        batch_size: Faces per mini-batch of the autoencoder; the other net takes one face.
    """

    epochs: int
    steps_per_epoch: int | None = None
    schedule: str = "constant"
    learning_rate: float = 1e-3
    batch_size: int = 16

    def optimizer(self, steps_per_epoch: int) -> keras.optimizers.Optimizer:
        """Adam with the schedule over all epochs."""
        check_choice(self.schedule, "schedule", ("constant", "cosine"))
        rate = self.learning_rate
        if self.schedule == "cosine":
            rate = keras.optimizers.schedules.CosineDecay(rate, self.epochs * steps_per_epoch)
        return keras.optimizers.Adam(rate)


def train_autoencoder(
    views: np.ndarray, frontal: np.ndarray, recipe: Recipe, *, seed: int = 0, **training
) -> tuple[keras.Model, dict[str, list[float]]]:
    """Train the autoencoder from views to frontal views (paper, J_autoencoder).

    Args:
        views: `(n, L, 2)` normalised views.
        frontal: `(n, L, 2)` x and y of the normalised shapes.
        recipe: Epochs, schedule and mini-batches.
        seed: Seed of the initial weights and of the order of the faces.
        training: `checkpoint` and `progress`, as for `train_by_epoch`.

    Returns:
        The network and its losses, as for `train_by_epoch`; `inference` is over the same faces.
    """
    n, n_landmarks = views.shape[:2]
    views, frontal = (np.float32(points).reshape(n, -1) for points in (views, frontal))
    size = min(recipe.batch_size, n)
    steps = recipe.steps_per_epoch or n // size
    model = build_autoencoder(n_landmarks, seed=seed)
    model.compile(recipe.optimizer(steps), "mse", steps_per_execution=steps_per_call(steps))

    def batches(epoch: int) -> tf.data.Dataset:
        faces = face_order(n, steps * size, seed, epoch).reshape(steps, size)
        return tf.data.Dataset.from_tensor_slices((views[faces], frontal[faces]))

    def inference() -> float:
        return float(np.mean((forward(model, views) - frontal) ** 2))

    label = {"network": model.name, "seed": seed, "faces": n, **asdict(recipe)}
    return model, train_by_epoch(model, batches, label, inference, **training)


def train_dissimilarity_net(
    frontal: np.ndarray,
    shapes: np.ndarray,
    recipe: Recipe,
    *,
    variant: str = "paper",
    shuffled: bool = False,
    chain: tuple[int, int] | None = None,
    seed: int = 0,
    **training,
) -> tuple[keras.Model, dict[str, list[float]]]:
    """Train the dissimilarity net, all pairs of one face a mini-batch (paper, J_Dissimilarity).

    The paper's variant sees each pair once. The released one sees every ordered pair of landmarks,
    including a landmark paired with itself, as the authors' code does.

    Args:
        frontal: `(n, L, 2)` frontal views as the autoencoder predicts them; normalised here.
        shapes: `(n, L, 3)` normalised shapes, whose distances are the targets.
        recipe: Epochs, steps and schedule; a step is one face.
        variant, chain: As for `build_dissimilarity_net`.
        shuffled: Whether a mini-batch has the same number of pairs drawn from all faces instead
            (the other scheme of the paper's "Ablation Study").
        seed: Seed of the initial weights and of the order of the faces.
        training: `checkpoint` and `progress`, as for `train_by_epoch`.

    Returns:
        The network and its losses; `inference` is over a fixed choice of fifty faces.
    """
    n, n_landmarks = shapes.shape[:2]
    frontal, shapes = np.float32(normalise(frontal)), np.float32(shapes)
    ends = np.triu_indices(n_landmarks, 1)
    if variant == "released":
        ends = np.indices((n_landmarks, n_landmarks)).reshape(2, -1)
    n_pairs, steps = len(ends[0]), recipe.steps_per_epoch or n
    model = build_dissimilarity_net(variant, seed=seed, chain=chain)
    # Most of a step is element-wise work on thousands of pairs, which XLA fuses.
    calls = steps_per_call(steps)
    model.compile(recipe.optimizer(steps), "mse", steps_per_execution=calls, jit_compile=True)

    def batches(epoch: int) -> tf.data.Dataset:
        # Pairs are computed alongside the training, a few faces ahead: all would fill the memory.
        if shuffled:
            rng = np.random.default_rng([seed, Stream.SHUFFLED_PAIRS, epoch])
            faces, drawn = (rng.integers(m, size=(steps, n_pairs)) for m in (n, n_pairs))
            views, points = (
                tuple(array[faces, end[drawn]] for end in ends) for array in (frontal, shapes)
            )
            data = tf.data.Dataset.from_tensor_slices((views, points))
            data = data.map(lambda *pairs: features_and_distances(*pairs, variant, tnp))
        else:
            faces = face_order(n, steps, seed, epoch)
            data = tf.data.Dataset.from_tensor_slices((frontal[faces], shapes[faces]))
            data = data.map(lambda *face: pairs_of_faces(*face, ends, variant, tnp))
        return data.prefetch(_STEPS_PER_CALL)

    check = slice(_DISSIMILARITY_CHECK_FACES)
    features, distances = pairs_of_faces(frontal[check], shapes[check], ends, variant)
    features, distances = features.reshape(-1, features.shape[-1]), distances.reshape(-1, 1)

    def inference() -> float:
        return float(np.mean((forward(model, features) - distances) ** 2))

    label = {"network": model.name, "seed": seed, "faces": n, **asdict(recipe)}
    if shuffled:
        label["shuffled"] = True
    return model, train_by_epoch(model, batches, label, inference, **training)


def pairs_of_faces(
    frontal: np.ndarray, shapes: np.ndarray, ends: tuple, variant: str, xp: Any = np
) -> tuple[np.ndarray, np.ndarray]:
    """Features `(…, P, F)` and distances `(…, P, 1)` of pairs of landmarks, for the net.

    Views are `(…, L, 2)`, shapes `(…, L, 3)`. `ends` has two arrays `(P,)`: the numbers of the
    first and of the second landmark of each pair. `variant` and `xp` are those of `proximities`.
    """
    both = ([xp.take(a, landmarks, axis=-2) for landmarks in ends] for a in (frontal, shapes))
    return features_and_distances(*both, variant, xp)


def features_and_distances(
    views: tuple, points: tuple, variant: str, xp: Any = np
) -> tuple[np.ndarray, np.ndarray]:
    """`pairs_of_faces` for landmarks that are already selected, as `(first, second)` each."""
    squares = xp.square(points[0] - points[1])
    return proximities(*views, variant, xp), xp.sqrt(xp.sum(squares, axis=-1, keepdims=True))


def train_by_epoch(
    model: keras.Model,
    batches: Callable[[int], tf.data.Dataset],
    label: dict,
    inference: Callable[[], float],
    checkpoint: str | Path | None = None,
    progress: Callable[[dict], object] | None = None,
) -> dict[str, list[float]]:
    """Fit a compiled model for `label["epochs"]` epochs, or resume from its checkpoint.

    The data of an epoch depend on its number alone, and the checkpoint holds the optimiser's state,
    so an interrupted run ends with the same weights as an uninterrupted one.

    Args:
        model: Compiled model.
        batches: Function from the number of an epoch to its mini-batches.
        label: What identifies the run; a checkpoint of another run is refused.
        inference: Computes the model's loss in inference mode, after an epoch.
        checkpoint: File to resume from, written after every epoch; None keeps no file.
        progress: Called after every epoch with its losses.

    Returns:
        Losses by epoch: `train` in training mode, while the weights change, and `inference`.

    Raises:
        InputError: The checkpoint is of another run, or damaged.
    """
    history = {"train": [], "inference": []}
    if checkpoint is not None and os.path.exists(checkpoint):
        description = read_checkpoint(checkpoint, model)
        _check_run(checkpoint, description["label"], label)
        history = description["history"]
    done = len(history["train"])
    for epoch in range(label["epochs"]):
        if epoch >= done:
            fitted = model.fit(untuned(batches(epoch)), shuffle=False, verbose=0)
            history["train"].append(float(fitted.history["loss"][0]))
            history["inference"].append(inference())
            if checkpoint is not None:
                write_checkpoint(checkpoint, model, {"label": label, "history": history})
        if progress is not None:
            progress({name: losses[epoch] for name, losses in history.items()})
    return history


def restore_network(
    model: keras.Model, checkpoint: str | Path, label: dict
) -> dict[str, list[float]]:
    """Load the weights of a finished training, and return its losses as `train_by_epoch` does.

    Args:
        model: Network of the same architecture.
        checkpoint: File that the training wrote.
        label: What is known of the run, including `"epochs"`; the data may be unknown.

    Raises:
        InputError: The file is missing, damaged, of another run, or of an unfinished training.
    """
    if not os.path.exists(checkpoint):
        raise InputError(f"{checkpoint} does not exist; {model.name} is not trained yet.")
    arrays, description = read_arrays(checkpoint)
    written, history = description.get("label", {}), description.get("history", {"train": []})
    label = {"network": model.name, **label}
    _check_run(checkpoint, {name: written.get(name) for name in label}, label)
    done, epochs = len(history["train"]), label["epochs"]
    if done < epochs:
        raise InputError(
            f"{checkpoint} is not trained to the end. Received {done} of {epochs} epochs."
        )
    set_network_arrays(model, arrays, str(checkpoint))
    return history


def _check_run(checkpoint: str | Path, received: dict, needed: dict) -> None:
    if received != needed:
        raise InputError(
            f"{checkpoint} is of another run; delete it to train again. "
            f"Received {received}, needed {needed}."
        )


def untuned(data: tf.data.Dataset) -> tf.data.Dataset:
    """The same mini-batches, without TensorFlow's autotuning thread.

    That thread doubles its sleep each time, and `fit` waits for it to wake: an epoch would take up
    to twice as long.
    """
    options = tf.data.Options()
    options.autotune.enabled = False
    return data.with_options(options)


def face_order(n_faces: int, n_wanted: int, seed: int, epoch: int) -> np.ndarray:
    """`(n_wanted,)` face numbers for an epoch: permutations of all faces, one after another.

    An epoch shorter than the data continues where the previous one stopped, so that every face is
    seen equally often.
    """
    first, skipped = divmod(epoch * n_wanted, n_faces)
    streams = ([seed, Stream.FACE_ORDER, first + k] for k in range(-(-n_wanted // n_faces) + 1))
    faces = [np.random.default_rng(stream).permutation(n_faces) for stream in streams]
    return np.concatenate(faces)[skipped : skipped + n_wanted]


def steps_per_call(steps: int) -> int:
    """The largest divisor of `steps` up to 50: a partial call would be compiled separately."""
    return max(k for k in range(1, _STEPS_PER_CALL + 1) if steps % k == 0)
