"""Step: Deep-MDS with one part after the other replaced by a better one, down to the limit.

On the first test faces of the paper's protocol. Each dissimilarity matrix goes through the
non-metric MDS of the method and through metric MDS.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator

import numpy as np
import pandas as pd

from data_gen.datasets.dataset import load_dataset
from deepmds_keras.embedding import embed, metric_embed, pairwise_distances
from experiments.figures.errors import Panel, error_lines
from experiments.figures.style import INK, Look, colour, marker
from experiments.inputs import Faces, load_faces
from experiments.lifting.contenders import limit
from experiments.lifting.train import DEEP_MDS, LIFTING, PAIR_NETS, network_file
from experiments.lifting.views import Views
from experiments.methods import load, predict
from experiments.progress import Bar
from experiments.run import Run
from experiments.scoring.numbers import power
from experiments.scoring.scores import score
from experiments.streams import Stream
from experiments.studies.study_results import grid, mean_error, write_results

STEPS = {
    "mean_shape": "Mean shape",
    "deep_mds": "Deep-MDS, cosine schedule",
    "true_frontal": "The true frontal view, not the autoencoder's",
    "landmarks_known": "A dissimilarity net that knows which landmarks it sees",
    "whole_view": "One that also sees the whole view, as it was given",
    "lifting": "The distances of the lifting network",
    "true_distances": "The true distances",
    "limit": "Limit: with the face model and the camera known",
}
EMBEDDINGS = {
    "non_metric": Look("Non-metric MDS", colour("ours"), marker("ours"), ""),
    "metric": Look("Metric MDS", colour("linear"), marker("linear"), ""),
    "none": Look("Without MDS", INK, "s", ""),
}
_UNIT = 1e-6


def matrices(run: Run, test: Faces) -> Iterator[tuple[str, np.ndarray]]:
    """Yield each step with dissimilarities and its matrices `(n, L, L)`."""
    import keras

    from experiments.lifting.pair_nets import dissimilarities

    deep_mds = load(run, DEEP_MDS)
    frontal, net = deep_mds.frontalise(test.views), deep_mds.dissimilarity_net_
    yield "deep_mds", dissimilarities(net, frontal, test.views)
    yield "true_frontal", dissimilarities(net, test.shapes[..., :2], test.views)
    for step in PAIR_NETS:
        net = keras.saving.load_model(network_file(run, f"anatomy-{step}"), compile=False)
        yield step, dissimilarities(net, frontal, test.views)
    yield "lifting", pairwise_distances(predict(load(run, LIFTING), test.views))
    yield "true_distances", pairwise_distances(test.shapes)


def measure(run: Run) -> pd.DataFrame:
    """Error of every step on the first test faces: `step, embedding, mse, sem, n_faces`."""
    dataset, faces = load_dataset(run.work / "test.npz"), slice(run.preset.audited_faces)
    test = load_faces(run, "test")[faces]
    mean_shape = load(run, "mean_shape").predict(test.views)
    errors = {("mean_shape", "none"): score(mean_shape, test).mse}
    for step, distances in Bar(matrices(run, test), desc="anatomy", total=len(STEPS) - 2):
        distances = np.abs(distances)  # as in `DeepMDS.predict`
        shapes = embed(distances, solver="sklearn", n_jobs=run.jobs)
        errors[step, "non_metric"] = score(shapes, test).mse
        errors[step, "metric"] = score(metric_embed(distances), test).mse
    exact = Views(
        identity=dataset.identity[faces],
        shapes=dataset.landmarks[faces].astype(float),
        views=dataset.views[faces],
        sd_mm=np.zeros(len(test.views)),
        cameras=dataset.cameras[faces],
    )
    rng = np.random.default_rng([run.seed, Stream.ANATOMY_LIMIT])
    errors["limit", "none"] = limit(run, exact, rng)
    return pd.DataFrame(
        {"step": step, "embedding": embedding} | mean_error(own)
        for (step, embedding), own in errors.items()
    )


def main(run: Run) -> dict:
    table = measure(run)
    cells = grid(table, "step", "embedding", _UNIT)[[*EMBEDDINGS]]
    cells.columns = [look.title for look in EMBEDDINGS.values()]
    cells = cells.rename(index=STEPS).rename_axis(f"MSE ({power(_UNIT)})")
    # True distances give the shape itself, which a logarithmic axis cannot show.
    rows = table[table["step"] != "true_distances"]
    rows = rows.rename(columns={"embedding": "method", "mse": "mean"})
    rows["step"] = [textwrap.fill(STEPS[step], 18) for step in rows["step"]]
    figures = {"anatomy": error_lines([Panel(rows, "step")], unit=_UNIT, looks=EMBEDDINGS)}
    return write_results(run, "lifting/anatomy", {"table": table}, cells, figures=figures)
