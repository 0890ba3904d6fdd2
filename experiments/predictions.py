"""Stage 3: what every method makes of the test views, one file a method."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from tqdm import tqdm

from deepmds_keras.baselines.aldrian import Aldrian
from deepmds_keras.baselines.linear import Linear
from deepmds_keras.baselines.mean_shape import MeanShape
from deepmds_keras.normalisation import normalise
from deepmds_keras.pipeline import DeepMDS
from deepmds_keras.weights import write_arrays
from experiments.faces import Faces, load_faces, load_landmark_model
from experiments.methods import DEEP_MDS
from experiments.parameters import write_parameter_table
from experiments.recipes import deep_mds, zhao
from experiments.run import AUTHORS_FILES, Run, parse_run, stage
from experiments.scores import costs, load_prediction

_FACES_PER_CHUNK = 250  # of the progress bar of methods that have none of their own


def fitted(run: Run, train: Faces, method: str):
    """A method of the table, ready to predict."""
    if method in DEEP_MDS:
        return deep_mds(run, train, method)[0]
    if method in ("zhao", "zhao_authors"):
        return zhao(run, train, method)
    if method == "zhao_frontal":
        return zhao(run, train, "zhao_authors")
    if method == "aldrian":
        return Aldrian(*load_landmark_model(run))
    if method == "authors_weights":
        return authors_weights(run)
    return {"mean_shape": MeanShape, "linear": Linear}[method]().fit(train.views, train.shapes)


def authors_weights(run: Run) -> DeepMDS:
    """The authors' released networks."""
    model = DeepMDS.from_released(*(Path(run.authors, name) for name in AUTHORS_FILES))
    return model.set_params(n_jobs=run.jobs)


def methods_of(run: Run) -> list[str]:
    """Methods that can be run here, in the order of the table."""
    methods = ["mean_shape", "linear", "zhao", "zhao_authors", "zhao_frontal", "aldrian", *DEEP_MDS]
    return methods + ["authors_weights"] * (run.authors is not None)


def predict(run: Run, train: Faces, test: Faces, method: str) -> None:
    """Write the predictions of one method, unless they are there."""
    path = run.prediction_file(method)
    if path.exists():
        return
    model = fitted(run, train, method)
    views = normalise(test.shapes[..., :2]) if method == "zhao_frontal" else test.views
    with tqdm(total=len(views), desc=method, unit="face") as bar:
        if isinstance(model, DeepMDS):
            arrays = {
                "shapes": model.predict(views, progress=bar.update),
                "frontal": model.frontalise(views),
            }
        else:
            arrays = {"shapes": np.empty_like(test.shapes)}
            for start in range(0, len(views), _FACES_PER_CHUNK):
                faces = slice(start, start + _FACES_PER_CHUNK)
                arrays["shapes"][faces] = model.predict(views[faces])
                bar.update(len(views[faces]))
    described = {
        "method": method,
        "n_parameters": int(model.n_parameters),
        "ms_per_face": milliseconds_per_face(model, views[: run.preset.timed_faces]),
    }
    write_arrays(path, {k: np.float32(a) for k, a in arrays.items()}, described)


def milliseconds_per_face(model, views: np.ndarray) -> float:
    """Time of one call of `predict` for all the views, in this process, after one to warm up."""
    if isinstance(model, DeepMDS):
        model = model.set_params(n_jobs=1)
    predict: Callable = model.predict
    predict(views)
    start = time.perf_counter()
    predict(views)
    return 1000 * (time.perf_counter() - start) / len(views)


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    with stage(run, "predictions") as record:
        if run.authors is not None:
            authors_weights(run)  # an unusable file is to be reported before the long work
        train, test = load_faces(run, "train"), load_faces(run, "test")
        record["methods"] = methods_of(run)
        for method in record["methods"]:
            predict(run, train, test, method)
        descriptions = {m: load_prediction(run, m)[1] for m in record["methods"]}
        write_parameter_table(run, costs(descriptions))


if __name__ == "__main__":
    main()
