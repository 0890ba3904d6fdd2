"""Files of faces and of what the method makes of them, each made and scored by itself.

A file of faces depends on the seed and its number alone, whichever process makes it and however
many there are; so a run that was stopped goes on, and one with more faces keeps those it has.
"""

from __future__ import annotations

import functools
import os
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

from data_gen.datasets.dataset import load_dataset, make_dataset, save_dataset
from data_gen.models.registry import load_model
from deepmds_keras.pipeline import DeepMDS
from deepmds_keras.weights import read_arrays, write_arrays
from experiments.inputs import as_seen
from experiments.progress import Bar
from experiments.run import Run, one_core, peak_memory_mb
from experiments.scoring.scores import score
from experiments.streams import Stream

# Those that take no longer to score than to read, beside the method itself.
BESIDE = ("mean_shape", "linear")
METRICS = ("mse", "depth_corr", "mirrored")
OURS = "ours"


@dataclass(frozen=True)
class Files:
    """The files of a stream.

    Attributes:
        folder: Where they are.
        n: Faces in all.
        per_file: Faces of each file but the last.
        digest: sha256 of the method's file: what another one made of the faces is not taken for
            its own.
    """

    folder: Path
    n: int
    per_file: int
    digest: str

    def __len__(self) -> int:
        return -(-self.n // self.per_file)

    def size(self, file: int) -> int:
        """Faces of a file."""
        return min(self.per_file, self.n - file * self.per_file)

    def faces(self, file: int) -> Path:
        """A data set, see `data_gen.datasets.dataset`; the last file has a name of its own."""
        return self.folder / "faces" / f"{self._name(file)}.npz"

    def shapes(self, file: int) -> Path:
        """What the method makes of it, and how far every method is from the truth."""
        return self.folder / f"shapes-{self.digest[:8]}" / f"{self._name(file)}.npz"

    def _name(self, file: int) -> str:
        whole = self.size(file) == self.per_file
        return f"{file:05}" if whole else f"{file:05}-{self.size(file)}"


def networks_file(folder: Path) -> Path:
    """Where a stream's method is, as `DeepMDS.save` writes it."""
    return folder / f"{OURS}.npz"


def make_file(run: Run, files: Files, file: int, beside: Mapping) -> tuple:
    """Make, predict and score the faces of one file, as far as that is not done.

    Args:
        run: The run.
        files: Of the stream.
        file: Number of the file.
        beside: Fitted methods to score on the same faces, by id.

    Returns:
        The number of faces, which process it was, and its peak memory in MB.
    """
    with one_core():
        if not files.faces(file).exists():
            rng = np.random.default_rng([run.seed, Stream.STREAMED_FACES, file])
            model = _model(run.model, run.data)
            size, how = files.size(file), {"scheme": run.scheme, "protocol": run.protocol}
            save_dataset(files.faces(file), make_dataset(model, size, rng, **how))
        if not files.shapes(file).exists():
            faces = as_seen(load_dataset(files.faces(file)))
            shapes = {method: fit.predict(faces.views) for method, fit in beside.items()}
            shapes[OURS] = _method(networks_file(files.folder), files.digest).predict(faces.views)
            arrays = {OURS: np.float32(shapes[OURS])}
            for method, predicted in shapes.items():
                scores = score(predicted, faces)
                for metric in METRICS:
                    arrays[f"{method}/{metric}"] = getattr(scores, metric)
            write_arrays(files.shapes(file), arrays, {"file": file}, compressed=False)
    return files.size(file), (socket.gethostname(), os.getpid()), peak_memory_mb()


def make_files(run: Run, files: Files, beside: Mapping) -> list[int]:
    """Make all the files that are not there.

    Returns:
        Peak memory in MB of every process that worked.
    """
    todo = [file for file in range(len(files)) if not files.shapes(file).exists()]
    done = files.n - sum(files.size(file) for file in todo)
    tasks = (delayed(make_file)(run, files, file, beside) for file in todo)
    memory: dict[tuple, int] = {}
    with Bar(total=files.n, initial=done, desc="faces", unit="face") as bar:
        for n, process, megabytes in Parallel(run.jobs, return_as="generator_unordered")(tasks):
            memory[process] = max(megabytes, memory.get(process, 0))
            bar.update(n)
    return [*memory.values()]


def read_scores(files: Files) -> dict[tuple[str, str], np.ndarray]:
    """`(n,)` values of all faces by method and metric: all that is in memory of all at once."""
    keys = [(method, metric) for method in (*BESIDE, OURS) for metric in METRICS]
    values = {key: np.empty(files.n) for key in keys}
    for file in range(len(files)):
        arrays, _ = read_arrays(files.shapes(file))
        for key in keys:
            values[key][file * files.per_file :][: files.size(file)] = arrays["/".join(key)]
    return values


@functools.cache
def _model(name: str, data: str | None):
    return load_model(name, data)


@functools.cache
def _method(networks: Path, digest: str) -> DeepMDS:
    """By the digest, since a worker of a cluster may live longer than the networks in a file."""
    return DeepMDS.load(networks).set_params(solver="batched", n_jobs=1)
