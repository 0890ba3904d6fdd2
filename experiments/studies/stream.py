"""Step: the tails of the errors, over any number of faces generated and scored in bounded memory.

The faces of a shard depend on the seed and its number alone, so that an interrupted run resumes,
and one with more faces keeps the existing shards.
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pandas as pd

from data_gen.datasets.dataset import make_dataset
from data_gen.models.registry import load_model
from deepmds_keras.files import read_arrays, write_arrays
from deepmds_keras.weights import checkpoint_files
from experiments.figures.errors import error_distribution
from experiments.inputs import as_seen
from experiments.methods import DEEP_MDS, load, predict
from experiments.progress import Progress
from experiments.records import resumable
from experiments.run import Run
from experiments.scoring.scores import score
from experiments.streams import Stream
from experiments.studies.study_results import statistics_cells, write_results
from experiments.tasks import unordered

_METHODS = ("mean_shape", "ridge", "deep_mds")
_METRICS = ("mse", "depth_corr", "mirrored")
# Statistic, or level of a quantile → its column.
_COLUMNS = {
    "count": "n_faces", "mean": "mean", "std": "std", "sem": "standard_error",
    0.05: "p5", 0.5: "median", 0.95: "p95", 0.99: "p99", "max": "maximum",
}  # fmt: skip


def main(run: Run) -> dict:
    values = stream(run)
    statistics = values.agg(["count", "mean", "std", "sem", "max"])
    table = pd.concat([statistics, values.quantile([0.05, 0.5, 0.95, 0.99])]).T
    table = table[[*_COLUMNS]].rename(columns=_COLUMNS).astype({"n_faces": int})
    table = table.rename_axis(["method", "metric"]).reset_index()
    figures = {"errors": error_distribution({name: values[name, "mse"] for name in _METHODS})}
    return write_results(run, "stream", {"table": table}, statistics_cells(table), figures=figures)


def stream(run: Run) -> pd.DataFrame:
    """Errors of all faces, with a column for each method and metric."""
    n, step = run.streamed_faces, run.preset.faces_per_file
    networks = checkpoint_files(run.networks, *DEEP_MDS["deep_mds"]).values()
    folder = resumable(run.work / "stream", [run.work / "train.npz", *networks], faces=step)
    sizes = [min(step, n - start) for start in range(0, n, step)]
    tasks = [(run, folder / f"{k:05}-{size}.npz", k, size) for k, size in enumerate(sizes)]
    missing = [task for task in tasks if not task[1].exists()]
    done = n - sum(size for *_, size in missing)
    with Progress("face", n, done) as bar:
        for size in unordered(run.jobs, write_shard, missing):
            bar.update(size)
    shards = [pd.DataFrame(read_arrays(path)[0]) for _, path, *_ in tasks]
    values = pd.concat(shards, ignore_index=True)
    values.columns = values.columns.str.split("/", expand=True)
    return values


def write_shard(run: Run, path: Path, shard: int, size: int) -> int:
    """Write the errors of every method on the faces of a shard; return its size."""
    rng = np.random.default_rng([run.seed, Stream.STREAMED_FACES, shard])
    model, methods = _loaded(run)
    faces = as_seen(make_dataset(model, size, rng, scheme=run.scheme, protocol=run.protocol))
    errors = {}
    for name, method in methods.items():
        scores = score(predict(method, faces.views), faces)
        errors |= {f"{name}/{metric}": getattr(scores, metric) for metric in _METRICS}
    write_arrays(path, errors, {"shard": shard}, compressed=False)
    return size


@functools.cache
def _loaded(run: Run) -> tuple:
    """The face model and the methods by id, loaded once per process."""
    methods = {method: load(run, method) for method in _METHODS}
    methods["deep_mds"].set_params(solver="numba", n_jobs=1)
    return load_model(run.model, run.data), methods
