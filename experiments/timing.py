"""Times of calls that are compared: taken in turns, so that what else runs meets all of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from experiments.running import single_threaded

PASSES = 5


def seconds_in_turns(calls: Sequence[Callable[[], object]], passes: int) -> np.ndarray:
    """`(passes, calls)` seconds of each call in each pass."""
    taken = np.empty((passes, len(calls)))
    for row in taken:
        for k, call in enumerate(calls):
            start = time.perf_counter()
            call()
            row[k] = time.perf_counter() - start
    return taken


def prediction_times(models: Sequence, inputs: Sequence[np.ndarray]) -> list[dict[str, float]]:
    """Times of one call of `predict` for all inputs of a model, in this process.

    One call of each is before, to warm up. Matrices are multiplied by one thread: of Aldrian's,
    which are small, many take far longer.

    Args:
        models: With `predict`.
        inputs: Of each model.

    Returns:
        Of each model `ms_per_face`, the median of `PASSES` times, and `ms_per_face_lowest` and
        `ms_per_face_highest`.
    """
    for model in models:
        if hasattr(model, "n_jobs"):
            model.set_params(n_jobs=1)
    calls = [lambda m=m, own=own: m.predict(own) for m, own in zip(models, inputs, strict=True)]
    with single_threaded():
        seconds_in_turns(calls, 1)
        taken = 1000 * seconds_in_turns(calls, PASSES) / [len(own) for own in inputs]
    return [
        {
            "ms_per_face": float(np.median(own)),
            "ms_per_face_lowest": float(own.min()),
            "ms_per_face_highest": float(own.max()),
        }
        for own in taken.T
    ]
