"""Print the table of a run that is done, and where its files are."""

from __future__ import annotations

import sys

import pandas as pd

from experiments.arguments import parse_run
from experiments.scoring.typesetting import text

# By the truth that a table is against, where there are two.
_TRUTHS = {
    "flame": "against the landmarks found on the scans, as in the paper",
    "flame-true-landmarks": "against the true landmarks, which the stand-in knows",
    "celeba": "against the model fitted to the photos, as in the paper",
    "celeba-true-landmarks": "against the true landmarks, which the stand-in knows",
}


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    names = [run.evaluation]
    if f"{run.track}-true-landmarks" in _TRUTHS:
        names.append(f"{run.track}-true-landmarks")
    paths = {name: run.experiment_results(name) / "table.csv" for name in names}
    first = paths[run.evaluation]
    if not first.is_file():
        print(
            f"error: {first} does not exist; delete {run.work}/{run.evaluation}.json and make it "
            "again.",
            file=sys.stderr,
        )
        raise SystemExit(2)
    for name, path in paths.items():
        if not path.is_file():
            continue
        table = pd.read_csv(path, dtype={"n_subsets": "Int64", "subset_size": "Int64"})
        truth = f", {_TRUTHS[name]}" if name in _TRUTHS else ""
        print(f"\n{run.model}, {run.preset.name} preset, seed {run.seed}{truth}\n")
        print(text(table, run.track))
    for path in paths.values():
        if path.is_file():
            print(f"Tables, figures and manifest: {path.parent}/")
