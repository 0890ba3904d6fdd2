"""Shards of a stream of faces: what the method makes of each, made and scored by itself.

A shard depends on the seed and its number alone, whichever process makes it and however
many there are; so a run that was stopped goes on, and one with more faces keeps those it has.
"""

from __future__ import annotations

import functools
import os
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from data_gen.datasets.dataset import load_dataset, make_dataset, save_dataset
from data_gen.models.registry import load_model
from deepmds_keras.io.archives import read_arrays, write_arrays
from experiments.inputs import as_seen
from experiments.progress import Bar
from experiments.run import Run
from experiments.running import peak_memory_mb
from experiments.scoring.scores import score
from experiments.streams import Stream
from experiments.tasks import unordered

if TYPE_CHECKING:
    from deepmds_keras.pipeline import DeepMDS

# Those that take no longer to score than to read, beside the method itself.
BESIDE = ("mean_shape", "linear")
METRICS = ("mse", "depth_corr", "mirrored")
OURS = "ours"


@dataclass(frozen=True)
class Shards:
    """The shards of a stream, a file of faces and one of shapes each.

    Attributes:
        folder: Where they are.
        n: Faces in all.
        per_file: Faces of each shard but the last.
        digest: sha256 of the method's file: what another one made of the faces is not taken for
            its own.
    """

    folder: Path
    n: int
    per_file: int
    digest: str

    def __len__(self) -> int:
        return -(-self.n // self.per_file)

    def size(self, shard: int) -> int:
        """Faces of a shard."""
        return min(self.per_file, self.n - shard * self.per_file)

    def faces(self, shard: int) -> Path:
        """A data set, see `data_gen.datasets.dataset`; the last shard has a name of its own."""
        return self.folder / "faces" / f"{self._name(shard)}.npz"

    def shapes(self, shard: int) -> Path:
        """File of the method's shapes, and of every method's errors."""
        return self.folder / f"shapes-{self.digest[:8]}" / f"{self._name(shard)}.npz"

    def _name(self, shard: int) -> str:
        whole = self.size(shard) == self.per_file
        return f"{shard:05}" if whole else f"{shard:05}-{self.size(shard)}"


def networks_file(folder: Path) -> Path:
    """Where a stream's method is, as `DeepMDS.save` writes it."""
    return folder / f"{OURS}.npz"


def make_shard(run: Run, shards: Shards, shard: int, beside: Mapping) -> tuple:
    """Make, predict and score the faces of one shard, as far as that is not done.

    Args:
        run: The run.
        shards: Of the stream.
        shard: Its index.
        beside: Fitted methods to score on the same faces, by id.

    Returns:
        The number of faces, which process it was, and its peak memory in MB.
    """
    if not shards.faces(shard).exists():
        rng = np.random.default_rng([run.seed, Stream.STREAMED_FACES, shard])
        model = _model(run.model, run.data)
        size, how = shards.size(shard), {"scheme": run.scheme, "protocol": run.protocol}
        save_dataset(shards.faces(shard), make_dataset(model, size, rng, **how))
    if not shards.shapes(shard).exists():
        faces = as_seen(load_dataset(shards.faces(shard)))
        shapes = {method: fit.predict(faces.views) for method, fit in beside.items()}
        shapes[OURS] = _method(networks_file(shards.folder), shards.digest).predict(faces.views)
        arrays = {OURS: np.float32(shapes[OURS])}
        for method, predicted in shapes.items():
            scores = score(predicted, faces)
            for metric in METRICS:
                arrays[f"{method}/{metric}"] = getattr(scores, metric)
        write_arrays(shards.shapes(shard), arrays, {"file": shard}, compressed=False)
    return shards.size(shard), (socket.gethostname(), os.getpid()), peak_memory_mb()


def make_shards(run: Run, shards: Shards, beside: Mapping) -> list[int]:
    """Make all the shards that are not there.

    Returns:
        Peak memory in MB of every process that worked.
    """
    todo = [shard for shard in range(len(shards)) if not shards.shapes(shard).exists()]
    done = shards.n - sum(shards.size(shard) for shard in todo)
    tasks = ((run, shards, shard, beside) for shard in todo)
    memory: dict[tuple, int] = {}
    with Bar(total=shards.n, initial=done, desc="faces", unit="face") as bar:
        for n, process, megabytes in unordered(run.jobs, make_shard, tasks):
            memory[process] = max(megabytes, memory.get(process, 0))
            bar.update(n)
    return [*memory.values()]


def read_scores(shards: Shards) -> dict[tuple[str, str], np.ndarray]:
    """`(n,)` values of all faces by method and metric: all that is in memory of all at once."""
    keys = [(method, metric) for method in (*BESIDE, OURS) for metric in METRICS]
    values = {key: np.empty(shards.n) for key in keys}
    for shard in range(len(shards)):
        arrays, _ = read_arrays(shards.shapes(shard))
        for key in keys:
            values[key][shard * shards.per_file :][: shards.size(shard)] = arrays["/".join(key)]
    return values


@functools.cache
def _model(name: str, data: str | None):
    return load_model(name, data)


@functools.cache
def _method(networks: Path, digest: str) -> DeepMDS:
    """By the digest, since a worker of a cluster may live longer than the networks in a shard."""
    # Here, since workers of a cluster read this module before they are told how it is to run.
    from deepmds_keras.pipeline import DeepMDS

    return DeepMDS.load(networks).set_params(solver="batched", n_jobs=1)
