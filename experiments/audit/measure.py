"""Step: measure one topic of the audit on test faces of the BFM track, as a CSV.

The module is light to import, since the Snakefile reads the names of the topics.
"""

from importlib import import_module

import numpy as np

from data_gen.datasets.dataset import load_dataset
from deepmds_keras.errors import InputError
from experiments.inputs import as_seen
from experiments.methods import load
from experiments.records import write_csv
from experiments.run import Run
from experiments.streams import Stream
from experiments.tasks import single_threaded

# Topic → the module whose function of the same name measures it.
TOPICS = dict.fromkeys(("poses", "noise", "perspective"), "poses") | dict.fromkeys(
    ("bias", "constants", "depth", "ranks", "samplings"), "shapes"
)


def main(run: Run, topic: str, *methods: str) -> dict:
    """Measure a topic; `methods` have predicted the test faces."""
    if topic not in TOPICS:
        raise InputError(f"TOPIC must be one of {', '.join(TOPICS)}. Received {topic}.")
    measure = getattr(import_module(f"experiments.audit.{TOPICS[topic]}"), topic)
    with single_threaded():  # sums in one order on any machine
        table = measure(Evidence(run, methods))
    write_csv(run.work / "audit" / f"{topic}.csv", table)
    return {"audited_faces": run.preset.audited_faces}


class Evidence:
    """Test faces of the BFM track, some of them chosen, and what trained methods make of them.

    Attributes:
        methods: Ids of those that have predicted the test faces.
        test: All test faces, `n` of them.
        views, landmarks: Of the audited faces, in millimetres: `(m, L, 2)` and `(m, L, 3)`.
        audited: `(m,)` numbers of the audited faces, for measurements that take long.
        shapes: `(m, L, 3)` of the audited faces.
    """

    def __init__(self, run: Run, methods: tuple[str, ...]):
        dataset = load_dataset(run.work / "test.npz")
        self.run, self.methods, self.test = run, methods, as_seen(dataset)
        n, rng = len(self.test.views), self.rng(Stream.AUDITED_FACES)
        self.audited = np.sort(rng.choice(n, min(run.preset.audited_faces, n), replace=False))
        self.views, self.landmarks, self.shapes = (
            array[self.audited].astype(float)
            for array in (dataset.views, dataset.landmarks, self.test.shapes)
        )

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
