"""Step: Deep-MDS with one part after another replaced by a better one, down to the lower bound.

It uses test faces of the paper's protocol and several seeds of training. Each row differs in one
thing from the row that its title names. Dissimilarity matrices go through the method's non-metric
MDS and through metric MDS.
"""

import textwrap
from collections.abc import Iterator

import keras
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from data_gen.datasets.dataset import load_dataset
from deepmds_keras.embedding import embed, metric_embed
from deepmds_keras.geometry.classical_scaling import pairwise_distances
from deepmds_keras.lifting.lifter import LandmarkLifter
from deepmds_keras.proximities import pair_features
from experiments.figures.errors import Panel, error_lines
from experiments.figures.style import INK, Look, look
from experiments.inputs import Faces, load_faces
from experiments.lifting.contenders import lower_bound
from experiments.lifting.train import LIFTING
from experiments.lifting.train_pairs import autoencoder, views_of_pairs
from experiments.lifting.variants import STEPS, VARIANTS, component_file
from experiments.lifting.views import Views
from experiments.methods import load, predict
from experiments.progress import Progress
from experiments.run import Run
from experiments.scoring.numbers import power
from experiments.scoring.scores import score
from experiments.streams import Stream
from experiments.studies.pair_training import dissimilarities
from experiments.studies.seed import recalibrate_batchnorm
from experiments.studies.study_results import grid, mean_error, write_results

_DRAWN = {
    "mean_shape": "mean shape", "constant": "constant rate", "cosine": "A: cosine schedule",
    "true_frontal": "A on true frontal views", "wide": "B: A with 64 units",
    "shuffled": "C: B with shuffled batches", "landmarks_known": "D: C + landmark identity",
    "whole_view": "D + full 2D input", "landmark_lifter": "LandmarkLifter",
    "lower_bound": "lower bound",  # true distances have no error, which no logarithm shows
}  # fmt: skip
EMBEDDINGS = {
    "non_metric": look("deep_mds")._replace(title="Non-metric MDS", dashes=""),
    "metric": look("zhao")._replace(title="Metric MDS", dashes=""),
    "none": Look("Without MDS", INK, "s", ""),
}
_UNIT = 1e-6
_NOTE = (
    "± is the standard error: over seeds of the dissimilarity net, on one autoencoder; of a single "
    "training over the test faces."
)
_RECALIBRATED_ON = 200  # training faces whose pairs are one batch
_TEST_FACES = 1_000  # at most, since each is predicted and embedded some fifty times


def matrices(run: Run, test: Faces, seed: int) -> Iterator[tuple[str, np.ndarray]]:
    """Yield each step with dissimilarities and its matrices `(n, L, L)`, of a seed."""
    train = load_faces(run, "train")
    for name, variant in VARIANTS.items():
        net = keras.saving.load_model(component_file(run, name, seed), compile=False)
        encoder = autoencoder(run, variant.frontal, variant.schedule)
        yield name, dissimilarities(net, views_of_pairs(variant, test, encoder), test.views)
        if name == "cosine":
            true = views_of_pairs(VARIANTS["true_frontal"], test, encoder)
            yield "true_frontal_tested", dissimilarities(net, true, test.views)
        if name == "constant":
            recalibrated = load(run, "deep_mds")
            flat = train.views.reshape(len(train.views), -1)
            recalibrated.autoencoder_ = recalibrate_batchnorm(recalibrated.autoencoder_, flat)
            pairs = views_of_pairs(variant, train[:_RECALIBRATED_ON], recalibrated.frontalise)
            net = recalibrate_batchnorm(net, np.concatenate(pair_features(np.float32(pairs))))
            seen = views_of_pairs(variant, test, recalibrated.frontalise)
            yield "recalibrated", dissimilarities(net, seen, test.views)
    lifter = LandmarkLifter.load(component_file(run, LIFTING, seed))
    yield "landmark_lifter", pairwise_distances(predict(lifter, test.views))


def measure(run: Run) -> pd.DataFrame:
    """Error of every step: `step, embedding, seed`, and of the faces `mse, sem, n_faces`.

    Rows that depend on no seed have that of the run.
    """
    dataset, test = load_dataset(run.work / "test.npz"), load_faces(run, "test")[:_TEST_FACES]
    rows = []

    def add(step: str, embedding: str, seed: int, errors: np.ndarray) -> None:
        rows.append({"step": step, "embedding": embedding, "seed": seed} | mean_error(errors))

    def embedded(step: str, distances: np.ndarray, seed: int) -> None:
        distances = np.abs(distances)  # as in `DeepMDS.predict`
        shapes = embed(distances, solver="numba", n_jobs=run.jobs)
        add(step, "non_metric", seed, score(shapes, test).mse)
        add(step, "metric", seed, score(metric_embed(distances, run.jobs), test).mse)

    mean_shape = load(run, "mean_shape").predict(test.views)
    add("mean_shape", "none", run.seed, score(mean_shape, test).mse)
    of_a_seed = len(STEPS) - len(("mean_shape", "true_distances", "lower_bound"))
    with Progress("matrices of distances", of_a_seed * len(run.few_seeds)) as progress:
        for seed in run.few_seeds:
            for step, distances in matrices(run, test, seed):
                embedded(step, distances, seed)
                progress.update()
    embedded("true_distances", pairwise_distances(test.shapes), run.seed)
    exact = Views(
        identity=dataset.identity,
        shapes=dataset.landmarks.astype(float),
        views=dataset.views,
        sd_mm=np.zeros(len(dataset.views)),
        cameras=dataset.cameras,
    )[:_TEST_FACES]
    rng = np.random.default_rng([run.seed, Stream.COMPONENT_BOUND])
    add("lower_bound", "none", run.seed, lower_bound(run, exact, rng))
    return pd.DataFrame(rows)


def over_seeds(errors: pd.DataFrame) -> pd.DataFrame:
    """`step, embedding, mse, sem, low, high, n_seeds`: mean and, for several seeds, their range.

    `sem` is the standard error over seeds or, for one seed, over faces; the ends are then those of
    a 95 % interval.
    """
    table = errors.groupby(["step", "embedding"], sort=False).agg(
        mse=("mse", "mean"), of_faces=("sem", "mean"), of_seeds=("mse", "sem"),
        low=("mse", "min"), high=("mse", "max"), n_seeds=("mse", "count"),
    )  # fmt: skip
    single = table["n_seeds"] == 1
    table.insert(1, "sem", table["of_seeds"].where(~single, table["of_faces"]))
    for end, sign in (("low", -1), ("high", 1)):
        table.loc[single, end] = (table["mse"] + sign * 1.96 * table["sem"])[single]
    return table.drop(columns=["of_faces", "of_seeds"]).reset_index()


def main(run: Run) -> dict:
    errors = measure(run)
    table = over_seeds(errors)
    cells = grid(table, "step", "embedding", _UNIT).reindex(index=[*STEPS])[[*EMBEDDINGS]]
    cells.columns = [look.title for look in EMBEDDINGS.values()]
    cells = cells.rename(index=STEPS).rename_axis(f"MSE ({power(_UNIT)})")
    tables, figures = {"table": table, "seeds": errors}, {"component_ablation": draw(table)}
    return write_results(run, "lifting/component-ablation", tables, cells, [_NOTE], figures)


def draw(table: pd.DataFrame) -> Figure:
    """Errors of most steps, with both kinds of MDS, of `table.csv`."""
    rows = table.rename(columns={"embedding": "method", "mse": "mean"})
    rows = rows.set_index("step").loc[[*_DRAWN]].reset_index()
    # The longest word is a little wider than its column, so that those beside it must be narrow.
    lines = textwrap.TextWrapper(10, break_long_words=False)
    rows["step"] = [lines.fill(_DRAWN[step]) for step in rows["step"]]
    options = {"looks": EMBEDDINGS, "interval": "range over seeds; of one, 95 % interval"}
    return error_lines([Panel(rows, "step")], unit=_UNIT, **options)
