"""Step: errors of methods on some of many faces, which are generated and scored in bounded memory.

The faces of a shard depend on the seed and its number alone, so that an interrupted run resumes,
and one with more faces keeps the existing shards. The module is light to import, since the rules
read the names of the parts.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_gen.datasets.dataset import make_dataset
from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.files import write_arrays
from deepmds_keras.weights import checkpoint_files
from experiments.inputs import as_seen, face_model
from experiments.methods import DEEP_MDS, load, predict
from experiments.progress import Progress
from experiments.records import resumable
from experiments.run import Run
from experiments.streams import Stream

METHODS = ("mean_shape", "ridge", "deep_mds")
_METRICS = ("mse", "depth_corr", "mirrored")
_SHARDS = 10  # in a part


@dataclass(frozen=True)
class Shard:
    """Some of the faces.

    Attributes:
        file: Their errors: `method/metric` to `(size,)`.
    """

    number: int
    size: int
    file: Path


def shards(run: Run) -> list[Shard]:
    """All shards of a run."""
    n, step = run.streamed_faces, run.preset.faces_per_file
    sizes = [min(step, n - start) for start in range(0, n, step)]
    folder = run.work / "stream"
    return [Shard(k, size, folder / f"{k:05}-{size}.npz") for k, size in enumerate(sizes)]


def stream_parts(run: Run) -> list[str]:
    """Names of parts that are done apart from each other, `first-last`: the faces of each."""
    n, step = run.streamed_faces, _SHARDS * run.preset.faces_per_file
    return [f"{start}-{min(start + step, n)}" for start in range(0, n, step)]


def main(run: Run, part: str) -> None:
    step = run.preset.faces_per_file
    networks = checkpoint_files(run.networks, *DEEP_MDS["deep_mds"]).values()
    resumable(run.work / "stream", [run.work / "train.npz", *networks], faces=step)
    start, end = map(int, part.split("-"))
    todo = [shard for shard in shards(run) if start <= shard.number * step < end]
    missing = [shard for shard in todo if not shard.file.exists()]
    model, methods = face_model(run), {m: load(run, m) for m in METHODS}
    methods["deep_mds"].set_params(solver="numba", n_jobs=1)
    left = sum(shard.size for shard in missing)
    with Progress("face", end - start, end - start - left) as bar:
        for shard in missing:
            write_shard(run, shard, model, methods)
            bar.update(shard.size)


def write_shard(run: Run, shard: Shard, model: MorphableModel, methods: dict) -> None:
    """Write the errors of every method on the faces of a shard."""
    from experiments.scoring.scores import score  # slow to load, by pandas

    rng = np.random.default_rng([run.seed, Stream.STREAMED_FACES, shard.number])
    dataset = make_dataset(model, shard.size, rng, scheme=run.scheme, protocol=run.protocol)
    faces, errors = as_seen(dataset), {}
    for name, method in methods.items():
        scores = score(predict(method, faces.views), faces)
        errors |= {f"{name}/{metric}": getattr(scores, metric) for metric in _METRICS}
    write_arrays(shard.file, errors, {"shard": shard.number}, compressed=False)
