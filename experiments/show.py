"""Print the BFM table of a run that is done, and where its files are."""

from __future__ import annotations

import sys

import pandas as pd

from experiments.run import parse_run
from experiments.typesetting import text


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    path = run.experiment_results(run.evaluation) / "table.csv"
    if not path.is_file():
        print(
            f"error: {path} does not exist; delete {run.work}/{run.evaluation}.json and make it "
            "again.",
            file=sys.stderr,
        )
        raise SystemExit(2)
    table = pd.read_csv(path, dtype={"n_subsets": "Int64", "subset_size": "Int64"})
    print(f"\n{run.model}, {run.preset.test_faces} test faces, seed {run.seed}\n")
    print(text(table, "bfm"))
    print(f"Tables, figures and manifest: {path.parent}/")


if __name__ == "__main__":
    main()
