"""Training steps of both networks: what each part of our way saves, and whether it changes weights.

Ours is what `deepmds_keras.training` does; each other way differs from it in what its note says.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import keras
import numpy as np
import tensorflow as tf
import tensorflow.experimental.numpy as tnp

from deepmds_keras.networks import build_autoencoder, build_dissimilarity_net
from deepmds_keras.normalisation import normalise
from deepmds_keras.training import (
    Recipe,
    face_order,
    pairs_of_faces,
    steps_per_call,
    train_autoencoder,
    train_dissimilarity_net,
    untuned,
)
from experiments.bench import released_code as released
from experiments.bench.measurements import RELEASED, Implementation
from experiments.bench.parts import OURS
from experiments.bench.workload import Workload

AUTOENCODER, DISSIMILARITY = "training step, autoencoder", "training step, dissimilarity net"
SAME_WEIGHTS = "weights as ours to the last bit"
_VARIANT = "paper"
_AHEAD = 50  # as in `deepmds_keras.training`
_BATCH = 16


@dataclass(frozen=True)
class Trainer:
    """A way to train a network.

    Attributes:
        name: Of the way.
        note: What it is.
        data: Makes what `fit` is given: one epoch.
        options: Further arguments of `fit`.
        many_steps: Whether many steps are made within a call of the graph.
        jit: Whether it is compiled by XLA.
    """

    name: str
    note: str
    data: Callable[[], object]
    options: dict
    many_steps: bool = False
    jit: bool = False


def comparisons(workload: Workload) -> Iterator[list[Implementation]]:
    """Ways to train the autoencoder, then those for the dissimilarity net."""
    steps = workload.run.preset.bench_steps
    views = normalise(workload.views[: len(workload.shapes)])
    frontal = workload.shapes[..., :2]
    made, _ = train_autoencoder(views, frontal, Recipe(1, steps))
    trainers = autoencoder_trainers(views, frontal, steps)
    n_faces = steps * min(_BATCH, len(views))
    yield _ways(AUTOENCODER, workload, trainers, made, steps, n_faces)
    made, _ = train_dissimilarity_net(frontal, workload.shapes, Recipe(1, steps), variant=_VARIANT)
    trainers = dissimilarity_trainers(frontal, workload.shapes, steps)
    yield _ways(DISSIMILARITY, workload, trainers, made, steps, steps)


def autoencoder_trainers(views: np.ndarray, frontal: np.ndarray, steps: int) -> list[Trainer]:
    """From `(n, L, 2)` views to `(n, L, 2)` frontal views."""
    n = len(views)
    size = min(_BATCH, n)
    views, frontal = (np.float32(points).reshape(n, -1) for points in (views, frontal))
    faces = face_order(n, steps * size, 0, 0)

    def one_by_one():
        for rows in faces.reshape(steps, size):
            yield np.stack([views[k] for k in rows]), np.stack([frontal[k] for k in rows])

    def sliced():
        rows = faces.reshape(steps, size)
        return tf.data.Dataset.from_tensor_slices((views[rows], frontal[rows]))

    def ours():
        return untuned(sliced())

    return [
        Trainer(RELEASED, "Python generator", one_by_one, {"steps_per_epoch": steps}),
        Trainer("numpy", "arrays given to fit", lambda: views[faces],
                {"y": frontal[faces], "batch_size": size}),
        Trainer("tf.data", "one step a call", sliced, {}),
        Trainer("+ prefetch", "one step a call", lambda: sliced().prefetch(_AHEAD), {}),
        Trainer("+ steps_per_execution", "many steps a call", sliced, {}, many_steps=True),
        Trainer(OURS, "tf.data untuned, many steps a call", ours, {}, many_steps=True),
        Trainer("ours + prefetch", "", lambda: ours().prefetch(_AHEAD), {}, many_steps=True),
        Trainer("ours + jit_compile", "", ours, {}, many_steps=True, jit=True),
    ]  # fmt: skip


def dissimilarity_trainers(frontal: np.ndarray, shapes: np.ndarray, steps: int) -> list[Trainer]:
    """From `(n, L, 2)` frontal views to the distances of `(n, L, 3)` shapes."""
    frontal, shapes = np.float32(normalise(frontal)), np.float32(shapes)
    faces = face_order(len(shapes), steps, 0, 0)
    frontal, shapes = frontal[faces], shapes[faces]
    first, second = np.triu_indices(shapes.shape[1], 1)

    def pairs(frontal, shapes):
        return pairs_of_faces(frontal, shapes, (first, second), _VARIANT, tnp)

    def loops():
        both = list(zip(first, second, strict=True))
        for view, shape in zip(frontal, shapes, strict=True):
            features = released.pair_features(view, _VARIANT, both)
            yield features, released.pair_distances(shape, both)

    def mapped(**options):
        return tf.data.Dataset.from_tensor_slices((frontal, shapes)).map(pairs, **options)

    features, distances = pairs_of_faces(frontal, shapes, (first, second), _VARIANT)
    flat = {"y": distances.reshape(-1, 1), "batch_size": len(first)}

    def precomputed():
        return untuned(tf.data.Dataset.from_tensor_slices((features, distances)).prefetch(_AHEAD))

    def ahead(**options):
        return mapped(**options).prefetch(_AHEAD)

    def ours(**options):
        return untuned(ahead(**options))

    many = {"many_steps": True}
    return [
        Trainer(RELEASED, "Python loops over pairs in a generator", loops,
                {"steps_per_epoch": steps}),
        Trainer("numpy", "features of all faces computed before, arrays given to fit",
                lambda: features.reshape(-1, features.shape[-1]), flat),
        Trainer("tf.data", "features in the graph, one step a call", mapped, {}),
        Trainer("+ prefetch", "one step a call", ahead, {}),
        Trainer("+ steps_per_execution", "many steps a call", ahead, {}, **many),
        Trainer("+ jit_compile", "", ahead, {}, **many, jit=True),
        Trainer(OURS, "tf.data untuned, prefetch, many steps a call, jit_compile", ours, {},
                **many, jit=True),
        Trainer("ours - prefetch", "", lambda: untuned(mapped()), {}, **many, jit=True),
        Trainer("ours, parallel map", "", lambda: ours(num_parallel_calls=2), {},
                **many, jit=True),
        Trainer("ours, features before", "features of all faces computed before, not counted",
                precomputed, {}, **many, jit=True),
    ]  # fmt: skip


def weights_note(network: keras.Model, ours: keras.Model) -> str:
    """Whether two networks have the same weights, or by how much they differ."""
    both = zip(network.get_weights(), ours.get_weights(), strict=True)
    own, other = (np.concatenate([w.ravel() for w in side]) for side in zip(*both, strict=True))
    if np.array_equal(own, other):
        return SAME_WEIGHTS
    difference = np.linalg.norm(own - other) / np.linalg.norm(other)
    return f"weights differ from ours by {difference:.1e} of their size"


def start(trainer: Trainer, steps: int, build: Callable[[], keras.Model]) -> tuple:
    """A network after one epoch, and what trains it for another."""
    network = build()
    network.compile(
        Recipe(1).optimizer(steps),
        "mse",
        steps_per_execution=steps_per_call(steps) if trainer.many_steps else 1,
        jit_compile=trainer.jit,
    )

    def epoch():
        network.fit(trainer.data(), shuffle=False, verbose=0, **trainer.options)

    epoch()
    return network, epoch


def _ways(part, workload, trainers, made, steps, n_faces) -> list[Implementation]:
    def build():
        if part == AUTOENCODER:
            return build_autoencoder(workload.n_landmarks)
        return build_dissimilarity_net(_VARIANT)

    if not workload.run.preset.bench_variants:
        trainers = [own for own in trainers if own.name in (RELEASED, OURS)]
    ways = []
    for trainer in trainers:
        network, epoch = start(trainer, steps, build)
        words = (trainer.note, f"{steps} steps", weights_note(network, made))
        ways.append(
            Implementation(part, trainer.name, epoch, workload.n_landmarks, n_faces,
                note="; ".join(filter(None, words)))
        )  # fmt: skip
    return ways
