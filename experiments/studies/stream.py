"""Any number of faces, made, given to the method and scored in bounded memory: the tails."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.stats import sem

from deepmds_keras.io.checksums import sha256_of
from experiments.arguments import parse_run
from experiments.figures.errors import error_distribution
from experiments.figures.style import save
from experiments.manifest import clear_results, records_of, write_manifest
from experiments.methods import load, title
from experiments.records import write_text
from experiments.running import single_threaded, stage
from experiments.scoring.latex import plain_tabular
from experiments.scoring.tables import write_csv
from experiments.studies.shards import BESIDE, OURS, Shards, make_shards, networks_file, read_scores

_QUANTILES = {"p5": 0.05, "median": 0.5, "p95": 0.95, "p99": 0.99}


def summarise(values: np.ndarray) -> dict[str, float]:
    """Mean over all faces, how sure it is, and how the faces spread."""
    return {
        "n_faces": len(values),
        "mean": values.mean(),
        "std": values.std(ddof=1),
        "standard_error": sem(values),
        **{name: np.quantile(values, share) for name, share in _QUANTILES.items()},
        "maximum": values.max(),
    }


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    folder = run.experiment_results("stream")
    with stage(run, "stream") as record:
        stream = run.work.absolute() / "stream"
        networks = networks_file(stream)
        # Without a number of processes: by its bytes the method is known.
        load(run, OURS).set_params(n_jobs=None).save(networks)
        with single_threaded():  # the regression's last bits depend on the threads
            beside = {method: load(run, method) for method in BESIDE}
        sizes = run.preset.streamed_faces, run.preset.faces_per_file
        shards = Shards(stream, *sizes, sha256_of([networks]))
        record["processes_mb"] = make_shards(run, shards, beside)
        values = read_scores(shards)
        clear_results(folder)
        table = pd.DataFrame(
            [
                {"method": method, "metric": metric, **summarise(own)}
                for (method, metric), own in values.items()
            ]
        )
        write_csv(folder / "table.csv", table)
        named = table.assign(method=table["method"].map(title))
        write_text(folder / "table.tex", plain_tabular(named))
        errors = {method: values[method, "mse"] for method in (*BESIDE, OURS)}
        save(error_distribution(errors), folder / "figures", "errors")
    write_manifest(run, "stream", records_of(run, "stream"), folder)
    print(f"\n{run.model}, {shards.n:,} faces\n")
    print(named.to_string(index=False))
    print(f"\nTable, figure and manifest: {folder}/")
