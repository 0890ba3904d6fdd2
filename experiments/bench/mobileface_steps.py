"""Training steps of MobileFace: images, kernels, threads, each way in processes of its own.

TensorFlow reads some of these settings once, so that the ways cannot be timed in turns: one is
after the other.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from deepmds_keras.photos import IMAGE_SIZE
from experiments.bench.measurements import NO_MEMORY
from experiments.progress import Bar
from experiments.run import Run
from experiments.running import quiet_tensorflow
from experiments.streams import Stream

PART = "training step, MobileFace"
_COEFFICIENTS, _LANDMARKS, _BATCH, _IMAGES = 199, 72, 16, 512
_AHEAD = 8  # as in `image_batches`
_STEPS_PER_PASS = 5  # one in so many of those of the other networks, which are faster


@dataclass(frozen=True)
class Way:
    """Settings of a training.

    Attributes:
        name: Of the way.
        within, beside: Threads within a layer, and of layers beside each other.
        onednn: Whether convolutions are oneDNN's.
        jit: Whether the step is compiled, and its operations fused, by XLA.
        stored: Type of the images in memory; `"float32"` are scaled before the training.
        ahead: Whether a thread of its own puts mini-batches together ahead of the training.
        processes: Each trains a network.
    """

    name: str
    within: int = 1
    beside: int = 2
    onednn: bool = True
    jit: bool = False
    stored: str = "uint8"
    ahead: bool = True
    processes: int = 1


WAYS = (
    Way("ours"),
    Way("images as float32", stored="float32"),
    Way("mini-batches not ahead", ahead=False),
    Way("without oneDNN", onednn=False),
    Way("compiled by XLA", jit=True),
    Way("one thread", beside=1),
    Way("two threads within a layer", within=2, beside=1),
    Way("two networks, a process and a thread each", beside=1, processes=2),
)


def mobileface_rows(run: Run) -> list[dict]:
    """A row for each way; of small presets of ours alone."""
    steps = max(1, run.preset.bench_steps // _STEPS_PER_PASS)
    ways = WAYS if run.preset.bench_variants else WAYS[:1]
    rows, context = [], multiprocessing.get_context("spawn")
    with Bar(total=len(ways), desc="bench, MobileFace", unit="row") as bar:
        for way in ways:
            arguments = [(way, steps, run.preset.bench_passes, run.seed)] * way.processes
            with ProcessPoolExecutor(way.processes, context, _set, (way,)) as processes:
                seconds = max(processes.map(_trained, *zip(*arguments, strict=True)))
            rows.append(
                {
                    "comparison": "training",
                    "part": PART,
                    "way": way.name,
                    "n_landmarks": _LANDMARKS,
                    "n_faces": steps * _BATCH * way.processes,
                    "jobs": way.processes,
                    "seconds": seconds,
                    "peak_memory_mb": float("nan"),
                    "note": f"{steps} steps of {_BATCH} images; {_size(way, run)}; {NO_MEMORY}",
                }
            )
            bar.update()
    return rows


def _size(way: Way, run: Run) -> str:
    """Of all images of a training, as a way stores them."""
    pixels = run.preset.train_images * IMAGE_SIZE**2 * 3
    return f"all images {pixels * np.dtype(way.stored).itemsize / 1e6:,.0f} MB"


def _set(way: Way) -> None:
    os.environ |= {
        "TF_NUM_INTRAOP_THREADS": str(way.within),
        "TF_NUM_INTEROP_THREADS": str(way.beside),
        "TF_ENABLE_ONEDNN_OPTS": str(int(way.onednn)),
    }


def _trained(way: Way, steps: int, passes: int, seed: int) -> float:
    """Median seconds of the passes after the first."""
    import keras

    from deepmds_keras.baselines.mobileface import build_mobileface_net
    from deepmds_keras.networks import scale_images
    from deepmds_keras.training import steps_per_call

    quiet_tensorflow()
    rng = np.random.default_rng([seed, Stream.BENCH])
    images = rng.integers(0, 256, (_IMAGES, IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
    if way.stored == "float32":
        images = np.asarray(scale_images(images))
    targets = np.float32(rng.standard_normal((_IMAGES, _COEFFICIENTS)))
    network = build_mobileface_net(_COEFFICIENTS)
    network.compile(
        keras.optimizers.Adam(),
        "mse",
        steps_per_execution=steps_per_call(steps),
        jit_compile=way.jit,
    )
    taken = []
    for _ in range(passes + 1):
        rows = rng.integers(0, _IMAGES, (steps, _BATCH))
        start = time.perf_counter()
        network.fit(mini_batches(way, images, targets, rows), shuffle=False, verbose=0)
        taken.append(time.perf_counter() - start)
    return float(np.median(taken[1:] or taken))


def mini_batches(way: Way, images: np.ndarray, targets: np.ndarray, rows: np.ndarray):
    """Mini-batches as a way puts them together; those of ours are `image_batches`.

    Args:
        way: Of `images`, which are stored as it says.
        images: `(n, size, size, 3)`.
        targets: `(n, d)` float32.
        rows: `(steps, batch)` which make up each mini-batch.

    Returns:
        `tf.data.Dataset` of images in [-1, 1] and targets.
    """
    import tensorflow as tf

    from deepmds_keras.networks import scale_images
    from deepmds_keras.training import image_batches, untuned

    if way.ahead and way.stored == "uint8":
        return untuned(image_batches(images, targets, rows))
    steps, batch = rows.shape
    signature = (
        tf.TensorSpec((batch, *images.shape[1:]), images.dtype),
        tf.TensorSpec((batch, targets.shape[1]), tf.float32),
    )
    data = tf.data.Dataset.from_generator(
        lambda: ((images[own], targets[own]) for own in rows), output_signature=signature
    ).apply(tf.data.experimental.assert_cardinality(steps))
    if way.stored == "uint8":
        data = data.map(lambda image, target: (scale_images(image), target))
    return untuned(data.prefetch(_AHEAD) if way.ahead else data)
