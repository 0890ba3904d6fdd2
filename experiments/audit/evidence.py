"""Evidence of the checks: faces, trained methods and results of the earlier targets."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from data_gen.datasets.dataset import Dataset, load_dataset
from data_gen.models.morphable_model import MorphableModel
from data_gen.models.registry import load_model
from deepmds_keras.io.checksums import sha256_of
from deepmds_keras.landmarks import LandmarkScheme, load_scheme
from experiments.inputs import Faces, load_faces
from experiments.methods import load
from experiments.run import SCHEMES, Run
from experiments.scoring.scores import Scores, load_predictions, score
from experiments.streams import Stream

# Stages whose files the checks read.
_STAGES = ("faces", "networks", "predictions", "mobileface", "ablation")


class Inputs:
    """Arrays of a run of the BFM track, each read when it is first asked for.

    Args:
        run: The run, whose stages up to the predictions are done. Data sets that it names are those
            of the results that are read.
    """

    def __init__(self, run: Run):
        self.run = run
        self.tables: dict[str, str] = {}  # tables read and their hashes

    @cached_property
    def train(self) -> Faces:
        return load_faces(self.run, "train")

    @cached_property
    def test(self) -> Faces:
        return load_faces(self.run, "test")

    @cached_property
    def test_dataset(self) -> Dataset:
        """Test faces in millimetres."""
        return load_dataset(self.run.work / "test.npz")

    @cached_property
    def train_dataset(self) -> Dataset:
        """Training faces in millimetres."""
        return load_dataset(self.run.work / "train.npz")

    @cached_property
    def scheme(self) -> LandmarkScheme:
        return load_scheme(self.run.scheme)

    @cached_property
    def model(self) -> MorphableModel:
        return load_model(self.run.model, self.run.data)

    @cached_property
    def predictions(self) -> dict[str, np.ndarray]:
        """Method to `(n, L, 3)` shapes of the test faces."""
        loaded = load_predictions(self.run)
        return {method: arrays["shapes"] for method, (arrays, _) in loaded.items()}

    @cached_property
    def scores(self) -> dict[str, Scores]:
        """Method to its errors on the test faces."""
        return {method: score(shapes, self.test) for method, shapes in self.predictions.items()}

    @cached_property
    def audited(self) -> np.ndarray:
        """`(n,)` some test faces, on which what takes long is measured."""
        rng = np.random.default_rng([self.run.seed, Stream.AUDITED_FACES])
        n = min(self.run.preset.audited_faces, len(self.test.views))
        return np.sort(rng.choice(len(self.test.views), n, replace=False))

    def method(self, method: str):
        """A method of the table, trained: what has `predict`."""
        if method not in self._methods:
            model = load(self.run, method)
            if hasattr(model, "solver"):
                # As scikit-learn to rounding, and many sweeps sooner.
                model.set_params(solver="batched", n_jobs=1)
            self._methods[method] = model
        return self._methods[method]

    @cached_property
    def _methods(self) -> dict:
        return {}

    def results(self, experiment: str, name: str = "metrics.csv") -> pd.DataFrame | None:
        """A table in `results/<model>/<experiment>`, or None: that target was not run."""
        track = experiment.split("-")[0]
        run = self.run.on(track if track in SCHEMES else "bfm")
        path = run.experiment_results(experiment) / name
        if not path.exists():
            return None
        self.tables[path.relative_to(run.model_results).as_posix()] = sha256_of([path])
        return pd.read_csv(path)

    @cached_property
    def key(self) -> dict[str, str]:
        """Hashes of the records of the stages that made the arrays."""
        records = (self.run.work / f"{stage}.json" for stage in _STAGES)
        return {path.stem: sha256_of([path]) for path in records if path.exists()}


def measured_file(run: Run, topic: str) -> Path:
    """Read what was measured for a topic that takes long."""
    return run.work / "audit" / f"{topic}.json"
