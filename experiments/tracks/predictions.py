"""Stage 3: what every method makes of the test views, one file per method."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from joblib import Parallel, delayed

from deepmds_keras.io.archives import write_arrays
from deepmds_keras.pipeline import DeepMDS
from experiments.arguments import parse_run
from experiments.inputs import Faces, load_faces
from experiments.methods import Method, load, methods_of
from experiments.progress import Bar
from experiments.run import Run
from experiments.running import call_single_threaded, stage
from experiments.timing import prediction_times

_FACES_PER_CHUNK = 250  # of the progress bar of methods that have none of their own


def predict(run: Run, test: Faces, method: Method) -> None:
    """Write the predictions of one method, unless they are there."""
    if not run.prediction_file(method.id).exists():
        write_prediction(run, method, load(run, method.id), method.sees(test), alone=False)


def write_prediction(run: Run, method: Method, model, inputs, *, alone: bool = True) -> None:
    """Write what a trained method makes of its inputs, views or images: one of each test face.

    Its time is written too if it is `alone` in its stage.
    """
    with Bar(total=len(inputs), desc=method.id, unit="face") as bar:
        if isinstance(model, DeepMDS):
            arrays = {
                "shapes": model.predict(inputs, progress=bar.update),
                "frontal": model.frontalise(inputs),
            }
        else:
            chunks = []
            for chunk in _predicted(run, method, model, inputs):
                chunks.append(chunk)
                bar.update(len(chunk))
            arrays = {"shapes": np.concatenate(chunks)}
    described = {
        "method": method.id,
        "n_parameters": int(model.n_parameters),
    }
    if alone:
        (times,) = prediction_times([model], [inputs[: run.preset.timed_faces]])
        described |= times
    write_shapes(run, method.id, arrays, described)


def _predicted(run: Run, method: Method, model, inputs) -> Iterator[np.ndarray]:
    starts = range(0, len(inputs), _FACES_PER_CHUNK)
    chunks = (inputs[start : start + _FACES_PER_CHUNK] for start in starts)
    if not method.one_by_one:  # done at once, or by networks, which stay in this process
        return map(model.predict, chunks)
    tasks = (delayed(call_single_threaded)(model.predict, chunk) for chunk in chunks)
    return Parallel(run.jobs if len(starts) > 1 else 1, return_as="generator")(tasks)


def write_shapes(run: Run, method: str, arrays: dict[str, np.ndarray], described: dict) -> None:
    """Write a method's predictions, `shapes` `(n, L, 3)`; NaN for a face that it did not find."""
    path = run.prediction_file(method)
    write_arrays(path, {k: np.float32(a) for k, a in arrays.items()}, described)


def times_of(run: Run, test: Faces, methods: Sequence[Method]) -> dict[str, dict[str, float]]:
    """Method to its times, as `prediction_times` returns them, taken in turns."""
    timed = test[: run.preset.timed_faces]
    models = [load(run, method.id) for method in methods]
    times = prediction_times(models, [method.sees(timed) for method in methods])
    return {method.id: own for method, own in zip(methods, times, strict=True)}


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    with stage(run, "predictions") as record:
        methods = methods_of(run, "predictions")
        test = load_faces(run, "test")
        record["methods"] = [method.id for method in methods]
        for method in methods:
            predict(run, test, method)
        record["times"] = times_of(run, test, methods)
