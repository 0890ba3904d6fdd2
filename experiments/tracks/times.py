"""Step: times of all methods, in turns, so that other load affects all alike; on one thread."""

import time
from collections.abc import Sequence

import numpy as np

from experiments.methods import METHODS, load, predict
from experiments.progress import counted
from experiments.run import Run
from experiments.tasks import single_threaded
from experiments.tracks.predict import inputs_for
from experiments.tracks.train import limit_threads


def prediction_times(
    models: Sequence, inputs: Sequence[np.ndarray], passes: int
) -> list[dict[str, float]]:
    """Times of one call of `predict` for all inputs of a model, in this process.

    A first call of each is for warming up. One thread multiplies matrices: for small ones, such as
    Aldrian's, several threads take far longer.

    Args:
        models: As from `methods.load`.
        passes: Timed predictions of each model, after the first.

    Returns:
        For each model `ms_per_face`, the median of all passes, `ms_per_face_lowest` and
        `ms_per_face_highest`.
    """
    for model in models:
        if hasattr(model, "n_jobs"):
            model.set_params(n_jobs=1)
    taken = np.empty((1 + passes, len(models)))
    with single_threaded():
        for row in counted("pass", taken, len(taken)):
            for k, (model, seen) in enumerate(zip(models, inputs, strict=True)):
                start = time.perf_counter()
                predict(model, seen)
                row[k] = 1000 * (time.perf_counter() - start) / len(seen)
    return [
        {
            "ms_per_face": float(np.median(row)),
            "ms_per_face_lowest": float(row.min()),
            "ms_per_face_highest": float(row.max()),
        }
        for row in taken[1:].T
    ]


def main(run: Run, *methods: str) -> dict:
    limit_threads(1)
    models = [load(run, method) for method in methods]
    inputs = [inputs_for(run, METHODS[m])[: run.preset.timed_faces] for m in methods]
    times = prediction_times(models, inputs, run.preset.timed_passes)
    return {"times": dict(zip(methods, times, strict=True))}
