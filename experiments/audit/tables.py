"""Numbers from the tables of results on one face model, by which claims are decided."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.run import SCHEMES, Run
from experiments.scoring.intervals import ONE_TRAINING, Estimate, point


@dataclass(frozen=True)
class Tables:
    """Tables of results on one face model, for a run of the BFM track. Missing numbers are NaN.

    Attributes:
        audit: Folder of the audit's own tables, if these are not in the results yet.
    """

    run: Run
    audit: Path | None = None

    def values(self, experiment: str, name: str, of: str, **where) -> np.ndarray:
        """A column of a table in `results/<model>/<experiment>`; one NaN if it has no such row.

        Args:
            where: What other columns hold in the rows: a value, or several to choose from.
        """
        track = experiment.split("-")[0]
        run = self.run.on(track if track in SCHEMES else "bfm")
        is_audit = experiment == "audit" and self.audit is not None
        folder = self.audit if is_audit else run.experiment_results(experiment)
        path = folder / f"{name}.csv"
        if not path.exists():
            return np.array([np.nan])
        table = pd.read_csv(path)
        for column, wanted in where.items():
            table = table[table[column].isin(np.atleast_1d(wanted))]
        return table[of].to_numpy() if len(table) else np.array([np.nan])

    def samplings(self, method: str, experiment: str = "bfm", metric: str = "mse") -> np.ndarray:
        """A method's means over random samplings of the test faces."""
        return self.values(experiment, "metrics", "value", method=method, metric=metric)

    def error(self, method: str) -> float:
        """A method's MSE on the BFM."""
        return float(self.samplings(method).mean())

    def seeds(self, method: str, metric: str = "mse") -> np.ndarray:
        """A method's means over all test faces, from each seed."""
        return self.samplings(method, "seeds", metric)

    def variant(self, variant: str, metric: str = "mse") -> np.ndarray:
        """A metric of a variant of the ablation, from each seed."""
        where = {"variant": variant, "metric": metric, "faces": self.run.preset.train_faces}
        return self.values("ablation", "metrics", "value", **where)

    def measured(self, topic: str, of: str, **where) -> Estimate:
        """One number of a topic of the audit."""
        return point(self.values("audit", topic, of, **where)[0])

    def over_faces(self, topic: str, of: str, standard_error: str, **where) -> Estimate:
        """One number of a topic, with the interval of its standard error over faces."""
        names = (of, standard_error)
        value, error = (self.measured(topic, name, **where).value for name in names)
        return Estimate(value, value - 1.96 * error, value + 1.96 * error, None, ONE_TRAINING[1])
