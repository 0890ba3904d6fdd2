"""Stage of the authors' released weights: a file that cannot be used is found before long work."""

from __future__ import annotations

from experiments.arguments import parse_run
from experiments.methods import load
from experiments.running import stage


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    with stage(run, "authors"):
        load(run, "authors_weights")
        # What other weights made of the test faces is of no use.
        run.prediction_file("authors_weights").unlink(missing_ok=True)
