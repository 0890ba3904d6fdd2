"""Numbers of a tiny run, kept in `golden.csv`: a move of code changes none of them.

Those of trained networks depend on the processor and its threads, and are compared loosely. Of
Deep-MDS it is the losses in training, not the errors on test faces, since in three epochs the
running statistics of batch normalisation come close to nothing. Rounding alone moves them: on one
processor, noise of 1e-7 in the views moved the autoencoder's by 3 %, and another processor by 15 %,
those of the dissimilarity nets by 0.6 %. That it predicts as it did is seen with the shipped
weights. To record the numbers again:
`PYTHONPATH=. python tests/test_golden.py FOLDER`, where FOLDER holds `build` and `results` of
`make reproduce-bfm PRESET=tiny`.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import runs
from faces import mean_landmarks

from data_gen.datasets.dataset import load_dataset
from deepmds_keras import DeepMDS, LandmarkLifter, align, metrics, normalise
from deepmds_keras.embedding import embed
from deepmds_keras.files import read_arrays
from deepmds_keras.geometry.alignment import is_mirrored
from deepmds_keras.geometry.classical_scaling import pairwise_distances

GOLDEN = Path(__file__).with_name("golden.csv")
EXACT = ("mean_shape", "ridge", "aldrian", "aldrian_authors")
METRICS = ("mse", "mse_mm2", "depth_corr", "depth_corr_across_faces", "reflection_rate")
# Method → relative tolerance of its error; the largest difference between two processors was 2 %.
CLOSE = {"ridge_roll_aligned": 1e-6, "zhao": 0.01, "landmark_lifter": 0.01}
LOOSE = ("deep_mds_cosine", "mlp", "mobileface", "zhao_authors", "zhao_frontal", "zhao_evaluator")
NETWORKS = CLOSE | dict.fromkeys(LOOSE, 0.2)
# Relative tolerance of a loss, by the first word of the network's name.
LOSSES = {"autoencoder": 0.25, "dissimilarity": 0.05, "lifting": 1e-3}
SHIPPED = {"Deep-MDS": (DeepMDS, "deepmds-bfm72"), "lifter": (LandmarkLifter, "bfm72")}


def of_tables(folder):
    """Means of the metrics of all methods."""
    table = pd.read_csv(runs.results(folder, "bfm") / "metrics.csv")
    for (method, metric), value in table.groupby(["method", "metric"])["value"].mean().items():
        if method in EXACT and metric in METRICS:
            yield f"{method} {metric}", value, 1e-6
        elif method in NETWORKS and metric == "mse":
            yield f"{method} {metric}", value, NETWORKS[method]


def of_trainings(folder):
    """Losses of the networks in their last epoch, in training mode."""
    for path in sorted((runs.work(folder, "bfm") / "networks").glob("*-*.npz")):
        history = read_arrays(path)[1]["history"]
        tolerance = LOSSES[path.stem.partition("-")[0]]
        yield f"{path.stem} loss", history["train"][-1], tolerance


def of_shipped_weights(test):
    """Errors of the weights that ship on the test faces; every face must stand the right way."""
    truth = normalise(test.landmarks)
    for name, (method, weights) in SHIPPED.items():
        shapes = method.pretrained(weights).predict(test.views)
        yield f"shipped {name} mse", metrics.mse(align(shapes, truth), truth).mean(), 1e-3
        yield f"shipped {name} mirrored", is_mirrored(shapes, truth).mean(), 0


def numbers(folder):
    """Table of `quantity, value, tolerance` (relative) of a tiny run."""
    test = load_dataset(runs.work(folder, "bfm") / "test.npz")
    rows = [*of_tables(folder), *of_trainings(folder), *of_shipped_weights(test)]
    for name in ("views", "landmarks", "identity"):
        rows.append((f"mean size of {name}", np.abs(getattr(test, name)).mean(dtype=float), 1e-6))
    distances = pairwise_distances(mean_landmarks("bfm72")[None])
    sizes = np.linalg.norm(embed(distances)[0], axis=1)
    rows.append(("distance of an embedded point of the chin to the centre", sizes[33], 1e-6))
    return pd.DataFrame(rows, columns=["quantity", "value", "tolerance"])


def test_a_tiny_run_has_the_numbers_that_it_had(whole_bfm):
    kept = pd.read_csv(GOLDEN).set_index("quantity")
    now = numbers(whole_bfm).set_index("quantity")["value"]
    assert {*kept.index} == {*now.index}
    wrong = [
        f"{quantity}: {now[quantity]:.9g}, not {value:.9g}"
        for quantity, (value, tolerance) in kept[["value", "tolerance"]].iterrows()
        if now[quantity] != pytest.approx(value, rel=tolerance, abs=1e-12)
    ]
    assert wrong == []


if __name__ == "__main__":
    numbers(Path(sys.argv[1])).to_csv(GOLDEN, index=False, float_format="%.9g")
