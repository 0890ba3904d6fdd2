"""Step: the tails of the errors, over any number of faces, from the shards of `stream_part`."""

import pandas as pd

from deepmds_keras.files import read_arrays
from experiments.figures.errors import error_distribution
from experiments.run import Run
from experiments.studies.stream_part import METHODS, shards
from experiments.studies.study_results import statistics_cells, write_results

# Statistic, or level of a quantile → its column.
_COLUMNS = {
    "count": "n_faces", "mean": "mean", "std": "std", "sem": "standard_error",
    0.05: "p5", 0.5: "median", 0.95: "p95", 0.99: "p99", "max": "maximum",
}  # fmt: skip


def main(run: Run) -> dict:
    parts = [pd.DataFrame(read_arrays(file)[0]) for file in shards(run)]
    values = pd.concat(parts, ignore_index=True)
    values.columns = values.columns.str.split("/", expand=True)
    statistics = values.agg(["count", "mean", "std", "sem", "max"])
    table = pd.concat([statistics, values.quantile([0.05, 0.5, 0.95, 0.99])]).T
    table = table[[*_COLUMNS]].rename(columns=_COLUMNS).astype({"n_faces": int})
    table = table.rename_axis(["method", "metric"]).reset_index()
    figures = {"errors": error_distribution({name: values[name, "mse"] for name in METHODS})}
    return write_results(run, "stream", {"table": table}, statistics_cells(table), figures=figures)
