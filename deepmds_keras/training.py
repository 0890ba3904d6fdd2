"""Training of the two networks, epoch by epoch, so that a stopped run goes on where it was."""

import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import keras
import numpy as np

from deepmds_keras.errors import InputError, check_choice
from deepmds_keras.files import read_arrays
from deepmds_keras.geometry.units import normalise
from deepmds_keras.networks import build_autoencoder, build_dissimilarity_net, forward
from deepmds_keras.proximities import proximities
from deepmds_keras.streams import Stream
from deepmds_keras.weights import (
    fingerprint,
    set_checkpoint,
    set_network_arrays,
    write_checkpoint,
)

SCHEDULES = ("constant", "cosine")
_STEPS_PER_CALL = 50  # steps of the optimiser within one call of the compiled graph
_CHECKED_FACES = 50
_NOT_IN_OLDER = ("arrays", "centre_views", "views")  # of what labels hold


@dataclass(frozen=True)
class Recipe:
    """Recipe of a network's training: Adam on the mean squared error.

    Attributes:
        epochs: Of `steps_per_epoch` mini-batches; a checkpoint is written after each.
        steps_per_epoch: Mini-batches in an epoch, or None for all of the data.
        schedule: `"constant"` learning rate (the paper and its code) or `"cosine"` decay to zero.
        learning_rate: Adam's initial learning rate.
        batch_size: Faces per mini-batch of the autoencoder, always 16; the other net takes one.
    """

    epochs: int
    steps_per_epoch: int | None = None
    schedule: str = "constant"
    learning_rate: float = 1e-3
    batch_size: int = field(default=16, init=False)

    def optimizer(self, steps_per_epoch: int) -> keras.optimizers.Optimizer:
        """Adam with the schedule over all epochs."""
        check_choice(self.schedule, "schedule", SCHEDULES)
        rate = float(self.learning_rate)
        if self.schedule == "cosine":
            rate = keras.optimizers.schedules.CosineDecay(rate, self.epochs * steps_per_epoch)
        return keras.optimizers.Adam(rate)


def train_autoencoder(
    views: np.ndarray, frontal: np.ndarray, recipe: Recipe, *, seed: int = 0, **training: Any
) -> tuple[keras.Model, dict[str, list[float]]]:
    """Train the autoencoder from views to frontal views (paper, J_autoencoder).

    Args:
        views: `(n, L, 2)` normalised views.
        frontal: `(n, L, 2)` x and y of the normalised shapes.
        seed: Seed of the initial weights and of the order of the faces.
        training: `checkpoint` and `progress`, as for `train_by_epoch`.

    Returns:
        The network and its losses, as for `train_by_epoch`; `inference` is over the same faces.
    """
    n, n_landmarks = views.shape[:2]
    inputs = np.asarray(views, np.float32).reshape(n, -1)
    targets = np.asarray(frontal, np.float32).reshape(n, -1)
    size = min(recipe.batch_size, n)
    steps = recipe.steps_per_epoch or n // size
    network = build_autoencoder(n_landmarks, seed=seed)
    network.compile(recipe.optimizer(steps), "mse", steps_per_execution=steps_per_call(steps))

    def mini_batches(epoch: int) -> dict[str, Any]:
        faces = face_order(n, steps * size, seed, epoch)
        return {"x": inputs[faces], "y": targets[faces], "batch_size": size}

    def inference() -> float:
        return float(np.mean((forward(network, inputs) - targets) ** 2))

    label = {"seed": seed, "data": fingerprint(inputs, targets), **asdict(recipe)}
    return network, train_by_epoch(network, mini_batches, label, inference, **training)


def train_dissimilarity_net(
    frontal: np.ndarray,
    shapes: np.ndarray,
    recipe: Recipe,
    *,
    variant: str = "paper",
    seed: int = 0,
    **training: Any,
) -> tuple[keras.Model, dict[str, list[float]]]:
    """Train the dissimilarity net, all pairs of one face a mini-batch (paper, J_Dissimilarity).

    The paper's variant sees each pair once. The released one sees every ordered pair of landmarks,
    including a landmark paired with itself, as the authors' code does.

    Args:
        frontal: `(n, L, 2)` frontal views as the autoencoder predicts them; normalised here.
        shapes: `(n, L, 3)` normalised shapes, whose distances are the targets.
        recipe: Epochs, steps and schedule; a step is one face.
        variant: As for `build_dissimilarity_net`.
        seed: Seed of the initial weights and of the order of the faces.
        training: `checkpoint` and `progress`, as for `train_by_epoch`.

    Returns:
        The network and its losses; `inference` is over a fixed choice of fifty faces.
    """
    n, n_landmarks = shapes.shape[:2]
    frontal = np.asarray(normalise(frontal), np.float32)
    shapes = np.asarray(shapes, np.float32)
    first, second = np.triu_indices(n_landmarks, 1)
    if variant == "released":
        first, second = np.indices((n_landmarks, n_landmarks)).reshape(2, -1)
    ends = first, second
    steps = recipe.steps_per_epoch or n
    network = build_dissimilarity_net(variant, seed=seed)
    compiled = compiled_by_xla(network, recipe.optimizer(steps), steps)

    def mini_batches(epoch: int) -> dict[str, Any]:
        faces = face_order(n, steps, seed, epoch)
        features, distances = pairs_of_faces(frontal[faces], shapes[faces], ends, variant)
        return {"x": features, "y": distances, "batch_size": len(ends[0])}

    checked = slice(_CHECKED_FACES)
    features, distances = pairs_of_faces(frontal[checked], shapes[checked], ends, variant)

    def inference() -> float:
        return float(np.mean((forward(network, features) - distances) ** 2))

    label = {"seed": seed, "data": fingerprint(frontal, shapes), **asdict(recipe)}
    return network, train_by_epoch(compiled, mini_batches, label, inference, **training)


def pairs_of_faces(
    frontal: np.ndarray, shapes: np.ndarray, ends: tuple[np.ndarray, ...], variant: str
) -> tuple[np.ndarray, np.ndarray]:
    """Features `(n P, F)` and distances `(n P, 1)` of P pairs of each face, one after the other.

    Views are `(n, L, 2)`, shapes `(n, L, 3)`, float32. `ends` has the first and the second landmark
    of each pair, `(P,)`.
    """
    first, second = ends
    features = proximities(frontal[:, first], frontal[:, second], variant)
    distances = np.linalg.norm(shapes[:, first] - shapes[:, second], axis=-1)
    return features.reshape(-1, features.shape[-1]), distances.reshape(-1, 1)


def compiled_by_xla(
    network: keras.Model, optimizer: keras.optimizers.Optimizer, steps: int
) -> keras.Model:
    """A model to train that has the layers of the network, which itself stays uncompiled.

    Most of a step is element-wise work on thousands of pairs, which XLA fuses. In use it would
    compile anew for every number of pairs.
    """
    model = keras.Model(network.inputs, network.outputs, name=network.name)
    calls = steps_per_call(steps)
    model.compile(optimizer, "mse", steps_per_execution=calls, jit_compile=True)
    return model


def train_by_epoch(
    model: keras.Model,
    mini_batches: Callable[[int], dict[str, Any]],
    label: dict,
    inference: Callable[[], float],
    checkpoint: str | Path | None = None,
    progress: Callable[[dict], object] | None = None,
    also: dict | None = None,
) -> dict[str, list[float]]:
    """Fit a compiled model for `label["epochs"]` epochs, or resume from its checkpoint.

    The data of an epoch depend on its number alone, and the checkpoint holds the optimiser's state,
    so an interrupted run ends with the same weights as an uninterrupted one.

    Args:
        mini_batches: From the number of an epoch to its data, as arguments of `model.fit`.
        label: Parameters of the run and `fingerprint` of its data; a checkpoint of another run is
            refused.
        inference: Computes the model's loss in inference mode, after an epoch.
        checkpoint: File to resume from, written after every epoch; None keeps no file.
        progress: Called after every epoch with its losses.
        also: More of the label.

    Returns:
        Losses by epoch: `train` in training mode, while the weights change, and `inference`.

    Raises:
        InputError: The checkpoint is of another run, or damaged.
    """
    label = {"network": model.name, **label, **(also or {})}
    history: dict[str, list[float]] = {"train": [], "inference": []}
    if checkpoint is not None and os.path.exists(checkpoint):
        arrays, description = read_arrays(checkpoint)
        _check_run(checkpoint, description.get("label", {}), label)
        set_checkpoint(model, arrays, str(checkpoint))
        history = description["history"]
    done = len(history["train"])
    for epoch in range(label["epochs"]):
        if epoch >= done:
            fitted = model.fit(**mini_batches(epoch), shuffle=False, verbose=0)
            history["train"].append(float(fitted.history["loss"][0]))
            history["inference"].append(inference())
            if checkpoint is not None:
                write_checkpoint(checkpoint, model, {"label": label, "history": history})
        if progress is not None:
            progress({name: losses[epoch] for name, losses in history.items()})
    return history


def restore_network(model: keras.Model, checkpoint: str | Path, label: dict) -> dict[str, Any]:
    """Load the weights of a finished training; return its `"label"`, and its losses as `"history"`.

    Args:
        model: Network of the same architecture.
        checkpoint: File that the training wrote.
        label: What is known of the run, including `"epochs"`; the data may be unknown.

    Raises:
        InputError: The file is missing, damaged, from another run, or unfinished.
    """
    if not os.path.exists(checkpoint):
        raise InputError(f"{checkpoint} does not exist; {model.name} is not trained yet.")
    arrays, description = read_arrays(checkpoint)
    written, history = description.get("label", {}), description.get("history", {"train": []})
    label = {"network": model.name, **label}
    _check_run(checkpoint, {name: written.get(name) for name in label}, label)
    done, epochs = len(history["train"]), label["epochs"]
    if done < epochs:
        raise InputError(f"{checkpoint} is only partly trained: {done} of {epochs} epochs.")
    set_network_arrays(model, arrays, str(checkpoint))
    return description


def _check_run(checkpoint: str | Path, received: dict, needed: dict) -> None:
    both = {name: (received.get(name), needed.get(name)) for name in {**needed, **received}}
    for name in _NOT_IN_OLDER:  # whose trainings are still taken
        if None in both.get(name, ()):
            del both[name]
    other = [name for name, (has, wants) in both.items() if has != wants]
    if other:
        has, wants = ({name: run.get(name) for name in other} for run in (received, needed))
        raise InputError(
            f"{checkpoint} is from another run; delete it to train again. "
            f"Received {has}, needed {wants}."
        )


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
