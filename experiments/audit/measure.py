"""Step: measure one topic of the audit on test faces of the BFM track, as a CSV.

The module is light to import, since the Snakefile reads the names of the topics.
"""

from __future__ import annotations

from functools import cached_property
from importlib import import_module

import numpy as np

from data_gen.datasets.dataset import Dataset, load_dataset
from deepmds_keras.errors import InputError
from experiments.inputs import Faces, load_faces
from experiments.methods import load
from experiments.records import write_csv
from experiments.run import Run
from experiments.streams import Stream
from experiments.tasks import single_threaded

# Topic → the module whose function of the same name measures it.
TOPICS = dict.fromkeys(("poses", "noise", "perspective"), "poses") | dict.fromkeys(
    ("bias", "constants", "depth", "ranks", "samplings"), "shapes"
)


def main(run: Run, topic: str) -> dict:
    if topic not in TOPICS:
        raise InputError(f"TOPIC must be one of {', '.join(TOPICS)}. Received {topic}.")
    measure = getattr(import_module(f"experiments.audit.{TOPICS[topic]}"), topic)
    with single_threaded():  # sums in one order on any machine
        table = measure(Evidence(run))
    write_csv(run.work / "audit" / f"{topic}.csv", table)
    return {"audited_faces": run.preset.audited_faces}


class Evidence:
    """Test faces, trained methods and their errors, on the BFM track.

    Args:
        run: The run, whose methods are trained and have predicted the test faces.
    """

    def __init__(self, run: Run):
        self.run = run

    @cached_property
    def test(self) -> Faces:
        return load_faces(self.run, "test")

    @cached_property
    def test_dataset(self) -> Dataset:
        """Test faces in millimetres."""
        return load_dataset(self.run.work / "test.npz")

    @cached_property
    def audited(self) -> np.ndarray:
        """`(n,)` numbers of some test faces, for measurements that take long."""
        n = min(self.run.preset.audited_faces, len(self.test.views))
        chosen = self.rng(Stream.AUDITED_FACES).choice(len(self.test.views), n, replace=False)
        return np.sort(chosen)

    @property
    def shapes(self) -> np.ndarray:
        """`(n, L, 3)` of the audited faces."""
        return self.test.shapes[self.audited].astype(float)

    @property
    def landmarks(self) -> np.ndarray:
        """`(n, L, 3)` of the audited faces, in millimetres."""
        return self.test_dataset.landmarks[self.audited].astype(float)

    def rng(self, stream: Stream) -> np.random.Generator:
        return np.random.default_rng([self.run.seed, stream])

    def scores(self, method: str):
        """`experiments.scoring.scores.Scores` of a method on all test faces."""
        from experiments.scoring.scores import load_prediction, score  # slow to load, by pandas

        return score(load_prediction(self.run, method)[0]["shapes"], self.test)

    def method(self, method: str):
        """A trained method, which `experiments.methods.predict` takes."""
        model = load(self.run, method)
        if hasattr(model, "solver"):
            # Equal to scikit-learn's to rounding, and many times faster.
            model.set_params(solver="numba", n_jobs=1)
        return model
