"""Train the weights that ship with the package, for landmarks found in photos, and measure them.

The networks and their training are those of `ours_stable`; the faces are not the paper's: every
expression and pose, with a detector's errors, and views are centred, since a photo does not show
where the face model's origin is.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from data_gen.models.morphable_model import MorphableModel
from data_gen.models.registry import load_model
from data_gen.views.photo_views import DETECTOR_SD_MM, sample_photo_views
from deepmds_keras.alignment import align
from deepmds_keras.baselines.linear import Linear
from deepmds_keras.baselines.mean_shape import MeanShape
from deepmds_keras.metrics import mse
from deepmds_keras.normalisation import centre, normalise
from deepmds_keras.pipeline import DeepMDS
from deepmds_keras.weights import PRETRAINED
from experiments.arguments import parse_run
from experiments.manifest import clear_results, records_of, write_manifest
from experiments.recipes import fit_deep_mds
from experiments.records import write_text
from experiments.run import SCHEMES, Run
from experiments.running import stage
from experiments.streams import Stream

# Standard deviation of the errors in the views, mm. No detector finds the 72: they come from fits
# of face models to photos.
_ERRORS_MM = {"ibug51": DETECTOR_SD_MM, "bfm72": 1.0}


def train(run: Run, views: np.ndarray, shapes: np.ndarray) -> DeepMDS:
    """The paper's method on centred views, with a decaying learning rate."""
    model = DeepMDS(
        views.shape[1],
        "paper",
        centre_views=True,
        schedule="cosine",
        autoencoder_epochs=run.preset.autoencoder_epochs,
        dissimilarity_epochs=run.preset.dissimilarity_epochs,
        dissimilarity_steps=run.preset.dissimilarity_steps,
        seed=run.seed,
    )
    fit_deep_mds(model, views, shapes)
    model.history_ = {}  # the curves would be a third of the file
    return model


def measure(
    run: Run, model: MorphableModel, scheme: str, methods: dict, seed: list[int]
) -> Iterator[dict]:
    """Mean squared error of each method on other faces, of detected and of exact landmarks."""
    for views_are, sd in (("detected", _ERRORS_MM[scheme]), ("exact", 0.0)):
        rng = np.random.default_rng(seed)
        n = run.preset.test_faces
        views, shapes, _ = sample_photo_views(model, scheme, n, rng, detector_sd=sd)
        truth = normalise(shapes)
        for method, fitted in methods.items():
            error = mse(align(fitted.predict(normalise(centre(views))), truth), truth)
            yield {
                "scheme": scheme,
                "views": views_are,
                "method": method,
                "mse": f"{error.mean():.6g}",
                "n_faces": n,
            }


def make(run: Run, number: int, scheme: str) -> tuple[Path, list[dict], str]:
    """Train and measure the weights of one scheme.

    Returns:
        Their file in the run's folder, the rows of the table, and the hash of the face model.
    """
    model = load_model(run.model, run.data, scheme)
    seed = [run.seed, Stream.PRETRAINED, number]
    rng = np.random.default_rng([*seed, 0])
    n, sd = run.preset.train_faces, _ERRORS_MM[scheme]
    views, shapes, _ = sample_photo_views(model, scheme, n, rng, detector_sd=sd)
    deep_mds = train(run, views, shapes)
    path = run.work / "pretrained" / f"{run.model}-{scheme}.npz"
    deep_mds.save(path)
    normal = normalise(centre(views)), normalise(shapes)
    methods = {
        "mean_shape": MeanShape().fit(*normal),
        "linear": Linear().fit(*normal),
        "ours_photo": deep_mds.set_params(n_jobs=run.jobs),
    }
    return path, [*measure(run, model, scheme, methods, [*seed, 1])], model.sha256


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    folder = run.experiment_results("pretrained")
    with stage(run, "pretrained") as record:
        made = [make(run, *each) for each in enumerate(dict.fromkeys(SCHEMES.values()))]
        table = pd.DataFrame([row for _, rows, _ in made for row in rows])
        clear_results(folder)
        write_text(folder / "table.csv", table.to_csv(index=False, lineterminator="\n"))
        record["model_sha256"] = made[0][2]
        print(table.to_string(index=False))
        for path, _, _ in made if run.preset.name == "paper" else ():
            shutil.copyfile(path, PRETRAINED / path.name)
            print(f"  {PRETRAINED / path.name}, {path.stat().st_size // 1000} kB")
    write_manifest(run, "pretrained", records_of(run, "pretrained"), folder)
