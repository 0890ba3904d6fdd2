"""Stage 3: what every method makes of the test views, one file a method."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

from deepmds_keras.baselines.aldrian import Aldrian
from deepmds_keras.baselines.linear import Linear
from deepmds_keras.baselines.mean_shape import MeanShape
from deepmds_keras.io.archives import write_arrays
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.normalisation import normalise
from deepmds_keras.pipeline import DeepMDS
from experiments.arguments import parse_run
from experiments.inputs import Faces, load_faces, load_landmark_model
from experiments.methods import DEEP_MDS
from experiments.progress import Bar
from experiments.run import AUTHORS_FILES, Run
from experiments.running import on_one_core, one_core, stage
from experiments.tracks.recipes import load_deep_mds, zhao

# Beside `DEEP_MDS`, and the methods that see images, which have stages of their own.
_METHODS = {
    "bfm": ("mean_shape", "linear", "zhao", "zhao_authors", "zhao_frontal", "aldrian"),
    "flame": ("mean_shape", "linear", "zhao"),
    "celeba": ("mean_shape", "linear", "zhao", "aldrian"),
}
_FACES_PER_CHUNK = 250  # of the progress bar of methods that have none of their own


def fitted(run: Run, train: Faces, method: str):
    """A method of the table, ready to predict.

    Args:
        run: The run, whose networks are those of `run.trained`.
        train: Training faces of that run.
        method: Its id.
    """
    run = run.trained
    if method in DEEP_MDS:
        return load_deep_mds(run, train, method)
    if method.startswith("zhao"):
        name = "zhao_authors" if method == "zhao_frontal" else method
        return zhao(run).restore(run.network_file(name))
    if method == "aldrian":
        return Aldrian(*load_landmark_model(run))
    if method == "authors_weights":
        return authors_weights(run)
    return {"mean_shape": MeanShape, "linear": Linear}[method]().fit(train.views, train.shapes)


def authors_weights(run: Run) -> DeepMDS:
    """The authors' released networks."""
    files = (Path(run.authors, name) for name in AUTHORS_FILES[run.track])
    model = DeepMDS.from_released(*files, n_landmarks=len(load_scheme(run.scheme)))
    return model.set_params(n_jobs=run.jobs)


def methods_of(run: Run) -> list[str]:
    """Methods that can be run here, in the order of the table."""
    methods = [*_METHODS[run.track], *DEEP_MDS]
    return methods + ["authors_weights"] * (run.authors is not None)


def predict(run: Run, train: Faces, test: Faces, method: str) -> None:
    """Write the predictions of one method, unless they are there."""
    if run.prediction_file(method).exists():
        return
    model = fitted(run, train, method)
    views = normalise(test.shapes[..., :2]) if method == "zhao_frontal" else test.views
    write_prediction(run, method, model, views)


def write_prediction(run: Run, method: str, model, inputs) -> None:
    """Write what a trained method makes of its inputs, views or images: one of each test face."""
    with Bar(total=len(inputs), desc=method, unit="face") as bar:
        if isinstance(model, DeepMDS):
            arrays = {
                "shapes": model.predict(inputs, progress=bar.update),
                "frontal": model.frontalise(inputs),
            }
        else:
            chunks = []
            for chunk in _predicted(run, model, inputs):
                chunks.append(chunk)
                bar.update(len(chunk))
            arrays = {"shapes": np.concatenate(chunks)}
    described = {
        "method": method,
        "n_parameters": int(model.n_parameters),
        "ms_per_face": milliseconds_per_face(model, inputs[: run.preset.timed_faces]),
    }
    write_shapes(run, method, arrays, described)


def _predicted(run: Run, model, inputs) -> Iterator[np.ndarray]:
    starts = range(0, len(inputs), _FACES_PER_CHUNK)
    chunks = (inputs[start : start + _FACES_PER_CHUNK] for start in starts)
    if not isinstance(model, Aldrian):  # done at once, or by networks, which stay in this process
        return map(model.predict, chunks)
    tasks = (delayed(on_one_core)(model.predict, chunk) for chunk in chunks)
    return Parallel(run.jobs if len(starts) > 1 else 1, return_as="generator")(tasks)


def write_shapes(run: Run, method: str, arrays: dict[str, np.ndarray], described: dict) -> None:
    """Write a method's predictions, `shapes` `(n, L, 3)`; NaN for a face that it did not find."""
    path = run.prediction_file(method)
    write_arrays(path, {k: np.float32(a) for k, a in arrays.items()}, described)


def milliseconds_per_face(model, inputs: np.ndarray) -> float:
    """Time of one call of `predict` for all the inputs, in this process, after one to warm up.

    Matrices are multiplied by one thread: of Aldrian's, which are small, many take far longer.
    """
    if isinstance(model, DeepMDS):
        model = model.set_params(n_jobs=1)
    predict: Callable = model.predict
    with one_core():
        predict(inputs)
        start = time.perf_counter()
        predict(inputs)
        return 1000 * (time.perf_counter() - start) / len(inputs)


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    with stage(run, "predictions") as record:
        if run.authors is not None:
            authors_weights(run)  # an unusable file is to be reported before the long work
        train, test = load_faces(run.trained, "train"), load_faces(run, "test")
        record["methods"] = methods_of(run)
        for method in record["methods"]:
            predict(run, train, test, method)
