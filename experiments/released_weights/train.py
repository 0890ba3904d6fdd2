"""Step: methods trained on faces around the Basel mean, at one scale of the s.d. and one seed."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from data_gen.datasets.dataset import make_dataset
from data_gen.models.morphable_model import MorphableModel
from data_gen.models.registry import load_model, model_files
from experiments import recipes
from experiments.inputs import Faces, as_seen
from experiments.methods import predict
from experiments.records import resumable, write_csv
from experiments.released_weights.bfm_mean import SCHEME, about_mean, mean_file, read_mean
from experiments.run import Run
from experiments.streams import Stream

SCALES = (0.8, 1.25, 2.0)


def trainings(run: Run) -> list[str]:
    """Names of the trainings: scale and seed."""
    return [f"{scale:g}-seed{seed}" for scale in SCALES for seed in run.few_seeds]


def trained_file(run: Run, name: str) -> Path:
    """Table of a training: `scale, seed, method, mse, depth_corr`."""
    return run.work / "released-weights" / f"{name}.csv"


def main(run: Run, name: str) -> None:
    import pandas as pd  # slow to load, and the Snakefile only asks for the names

    from experiments.scoring.scores import score

    scale, _, seed = name.partition("-seed")
    seeded = replace(run, seed=int(seed))
    model = load_model(run.model, run.data, SCHEME)
    model = about_mean(model, float(scale), read_mean(run))
    train = _faces(seeded, model, run.preset.train_faces, Stream.RELEASED_WEIGHTS_TRAINING)
    test = _faces(seeded, model, run.preset.test_faces, Stream.RELEASED_WEIGHTS_FACES)
    made_from = [mean_file(run), *model_files(run.model, run.data)]
    folder = resumable(run.work / "released-weights" / name, made_from)
    data = train.views, train.shapes
    ours = recipes.deep_mds(seeded, "paper", "constant").set_params(solver="numba", n_jobs=1)
    lifting = recipes.landmark_lifter(seeded)
    methods = {
        "mean_shape": recipes.mean_shape(seeded).fit(*data),
        "ridge": recipes.ridge(seeded).fit(*data),
        "deep_mds": recipes.fit(ours, *data, checkpoint=folder),
        "landmark_lifter": recipes.fit(lifting, *data, checkpoint=folder / "lifting.npz"),
    }
    rows = []
    for method, fitted in methods.items():
        scores = score(predict(fitted, test.views), test)
        row = {"scale": float(scale), "seed": seeded.seed, "method": method}
        rows.append(row | {"mse": scores.mse.mean(), "depth_corr": scores.depth_corr.mean()})
    write_csv(trained_file(run, name), pd.DataFrame(rows))


def _faces(run: Run, model: MorphableModel, n: int, stream: Stream) -> Faces:
    rng = np.random.default_rng([run.seed, stream])
    return as_seen(make_dataset(model, n, rng, scheme=SCHEME, protocol=run.protocol))
