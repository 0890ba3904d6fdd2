"""Step: errors of methods on some of many faces, which are generated and scored in bounded memory.

The faces of a shard depend on the seed and its number alone, so that an interrupted run resumes,
and one with more faces keeps the existing shards. The module is light to import, since the rules
read the names of the parts.
"""

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


def shards(run: Run) -> dict[Path, range]:
    """All shards of a run: files of errors, `method/metric` to `(n,)`, and their faces."""
    faces, step = range(run.streamed_faces), run.preset.faces_per_file
    parts = [faces[start : start + step] for start in faces[::step]]
    folder = run.work / "stream"
    return {folder / f"{k:05}-{len(part)}.npz": part for k, part in enumerate(parts)}


def stream_parts(run: Run) -> list[str]:
    """Names of parts that are done apart from each other, `first-last`: the faces of each."""
    n, step = run.streamed_faces, _SHARDS * run.preset.faces_per_file
    return [f"{start}-{min(start + step, n)}" for start in range(0, n, step)]


def main(run: Run, part: str) -> None:
    step = run.preset.faces_per_file
    networks = checkpoint_files(run.networks, *DEEP_MDS["deep_mds"]).values()
    resumable(run.work / "stream", [run.work / "train.npz", *networks], faces=step)
    faces = range(*map(int, part.split("-")))
    todo = {file: some for file, some in shards(run).items() if some.start in faces}
    missing = {file: some for file, some in todo.items() if not file.exists()}
    model, methods = face_model(run), {m: load(run, m) for m in METHODS}
    methods["deep_mds"].set_params(solver="numba", n_jobs=1)
    left = sum(map(len, missing.values()))
    with Progress("face", len(faces), len(faces) - left) as bar:
        for file, some in missing.items():
            write_shard(run, file, some, model, methods)
            bar.update(len(some))


def write_shard(run: Run, file: Path, faces: range, model: MorphableModel, methods: dict) -> None:
    """Write the errors of every method on the faces of a shard."""
    from experiments.scoring.scores import score  # slow to load, by pandas

    number = faces.start // run.preset.faces_per_file
    rng = np.random.default_rng([run.seed, Stream.STREAMED_FACES, number])
    dataset = make_dataset(model, len(faces), rng, scheme=run.scheme, protocol=run.protocol)
    test, errors = as_seen(dataset), {}
    for name, method in methods.items():
        scores = score(predict(method, test.views), test)
        errors |= {f"{name}/{metric}": getattr(scores, metric) for metric in _METRICS}
    write_arrays(file, errors, {"shard": number}, compressed=False)
