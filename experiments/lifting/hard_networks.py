"""Networks of the protocol `hard`: which are trained, on what, and how they are read again.

Lifting sees new faces in every step; Deep-MDS, which goes over its faces many times, as many as in
the paper. All come from the sampler of the condition.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deepmds_keras.landmarks import load_scheme
from deepmds_keras.lifting.lifter import LandmarkLifter
from experiments.lifting.views import (
    CONDITIONS,
    MIXED,
    TRAININGS,
    Condition,
    landmark_model,
    sample_training,
    training_faces,
)
from experiments.methods import METHODS
from experiments.recipes import deep_mds, fit_deep_mds, fit_lifter
from experiments.records import write_json
from experiments.run import Run
from experiments.trainings import side_by_side

if TYPE_CHECKING:
    from deepmds_keras.pipeline import DeepMDS

SEEDS = 3
SEEDED = "hard_1"  # condition for which lifting is trained from so many seeds
LIFTERS = {"lifting": "small", "lifting_large": "large"}
DEEP_MDS = "ours_stable"
_LEARNING_RATE = 3e-3
# Method, condition and seed: what one number of the tables is of.
Cell = tuple[str, Condition, int]


@dataclass(frozen=True)
class Training:
    """A network to train.

    Attributes:
        method: Its id.
        condition: Of the views that it is trained on.
        seed: Of its weights and faces.
    """

    method: str
    condition: Condition
    seed: int

    @property
    def id(self) -> str:
        return f"{self.method}-{self.condition.training}-seed{self.seed}"

    def file(self, run: Run, kind: str = "npz") -> Path:
        """Of the trained network; `json`: of how long it took."""
        return run.work / "hard" / "networks" / f"{self.id}.{kind}"


def training_of(method: str, condition: Condition, seed: int) -> Training | None:
    """The network that a method uses in a condition, if it has one for it."""
    if method == DEEP_MDS and condition.missing:
        return None
    if method == "lifting_large":
        return Training(method, MIXED, seed)
    return Training(method, TRAININGS[condition.training], seed)


def seeds_of(run: Run, method: str, condition: Condition) -> range:
    """Seeds from which a method is trained for a condition."""
    seeded = method == "lifting" and condition.id == SEEDED
    return range(run.seed, run.seed + (min(SEEDS, run.preset.n_seeds) if seeded else 1))


def trainings(run: Run) -> list[Training]:
    """Every network, those that take long first."""
    found = [
        training_of(method, condition, seed)
        for method in ("lifting_large", DEEP_MDS, "lifting")
        for condition in CONDITIONS
        for seed in seeds_of(run, method, condition)
    ]
    return [*dict.fromkeys(training for training in found if training is not None)]


def train(run: Run) -> list[int]:
    """Train what is not trained yet, a process per core.

    Returns:
        Peak memory of each process, MB.
    """
    todo = [training for training in trainings(run) if not training.file(run).exists()]
    return side_by_side(run.jobs, _train, [(run, training) for training in todo])[1]


def _train(run: Run, training: Training) -> None:
    checkpoint = run.work / "hard" / "checkpoints" / training.id
    goes_on, start = checkpoint.exists(), time.perf_counter()
    checkpoint.mkdir(parents=True, exist_ok=True)
    if training.method == DEEP_MDS:
        network = _train_deep_mds(run, training, checkpoint)
    else:
        network = _train_lifter(run, training, checkpoint / "lifting.npz")
    seconds = None if goes_on else round(time.perf_counter() - start, 1)
    described = {"seconds": seconds, "n_parameters": int(network.n_parameters)}
    write_json(training.file(run, "json"), described)
    network.save(training.file(run))


def _train_deep_mds(run: Run, training: Training, checkpoint: Path) -> DeepMDS:
    model = deep_mds(replace(run, seed=training.seed), *METHODS[DEEP_MDS].deep_mds)
    faces = training_faces(run, training.condition)
    return fit_deep_mds(model, faces.views, faces.shapes, checkpoint=checkpoint)


def _train_lifter(run: Run, training: Training, checkpoint: Path) -> LandmarkLifter:
    lifter = LandmarkLifter(
        len(load_scheme(run.scheme)),
        LIFTERS[training.method],
        steps=run.preset.lifting_steps,
        learning_rate=_LEARNING_RATE,
        seed=training.seed,
    )
    return fit_lifter(lifter, sampler(run, training), checkpoint=checkpoint)


def sampler(run: Run, training: Training) -> Callable:
    """Return what `LandmarkLifter.fit` samples faces by: views, shapes and the noise's s.d."""
    landmarks = landmark_model(run)

    def sample(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        faces = sample_training(landmarks, training.condition, n, rng)
        return faces.views, faces.shapes, faces.sd_mm

    return sample


def load_network(run: Run, training: Training) -> DeepMDS | LandmarkLifter:
    """Read a trained network."""
    if training.method != DEEP_MDS:
        return LandmarkLifter.load(training.file(run))
    from deepmds_keras.pipeline import DeepMDS

    return DeepMDS.load(training.file(run)).set_params(solver="batched", n_jobs=1)


def describe_networks(run: Run) -> dict[str, dict]:
    """Seconds of each training, None where it went on after a stop, and parameters by method."""
    read = {
        training: json.loads(training.file(run, "json").read_text(encoding="utf-8"))
        for training in trainings(run)
    }
    return {
        "training_seconds": {training.id: own["seconds"] for training, own in read.items()},
        "n_parameters": {training.method: own["n_parameters"] for training, own in read.items()},
    }
