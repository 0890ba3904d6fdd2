"""Print the BFM table of a run that is done, and where its files are."""

from __future__ import annotations

import pandas as pd

from experiments.run import parse_run
from experiments.typesetting import text


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    folder = run.bfm_results
    table = pd.read_csv(folder / "table.csv", dtype={"n_subsets": "Int64", "subset_size": "Int64"})
    print(f"\n{run.model}, {run.preset.test_faces} test faces, seed {run.seed}\n")
    print(text(table, "bfm"))
    print(f"Tables, figures and manifest: {folder}/")


if __name__ == "__main__":
    main()
