"""Training steps of MobileFace: threads, processes and oneDNN, each in processes of its own.

TensorFlow reads these settings once, so that the ways cannot be timed in turns: one is after the
other.
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
_STEPS_PER_PASS = 5  # one in so many of those of the other networks, which are faster


@dataclass(frozen=True)
class Way:
    """Settings of a training: threads within a layer and beside each other, oneDNN, processes."""

    name: str
    within: int
    beside: int
    onednn: bool = True
    processes: int = 1


WAYS = (
    Way("ours", 1, 2),
    Way("without oneDNN", 1, 2, onednn=False),
    Way("one thread", 1, 1),
    Way("two threads within a layer", 2, 1),
    Way("two networks, a process and a thread each", 1, 1, processes=2),
)


def mobileface_rows(run: Run) -> list[dict]:
    """A row for each way; of small presets of ours alone."""
    steps = max(1, run.preset.bench_steps // _STEPS_PER_PASS)
    ways = WAYS if run.preset.bench_variants else WAYS[:1]
    rows, context = [], multiprocessing.get_context("spawn")
    with Bar(total=len(ways), desc="bench, MobileFace", unit="row") as bar:
        for way in ways:
            arguments = [(steps, run.preset.bench_passes, run.seed)] * way.processes
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
                    "note": f"{steps} steps of {_BATCH} images; {NO_MEMORY}",
                }
            )
            bar.update()
    return rows


def _set(way: Way) -> None:
    os.environ |= {
        "TF_NUM_INTRAOP_THREADS": str(way.within),
        "TF_NUM_INTEROP_THREADS": str(way.beside),
        "TF_ENABLE_ONEDNN_OPTS": str(int(way.onednn)),
    }


def _trained(steps: int, passes: int, seed: int) -> float:
    """Median seconds of the passes after the first."""
    import keras

    from deepmds_keras.baselines.mobileface import build_mobileface_net
    from deepmds_keras.training import image_batches, steps_per_call, untuned

    quiet_tensorflow()
    rng = np.random.default_rng([seed, Stream.BENCH])
    images = rng.integers(0, 256, (_IMAGES, IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
    targets = np.float32(rng.standard_normal((_IMAGES, _COEFFICIENTS)))
    network = build_mobileface_net(_COEFFICIENTS)
    network.compile(keras.optimizers.Adam(), "mse", steps_per_execution=steps_per_call(steps))
    taken = []
    for _ in range(passes + 1):
        rows = rng.integers(0, _IMAGES, (steps, _BATCH))
        start = time.perf_counter()
        network.fit(untuned(image_batches(images, targets, rows)), verbose=0)
        taken.append(time.perf_counter() - start)
    return float(np.median(taken[1:] or taken))
