"""Step: print the table of some methods before those that take long are trained."""

from __future__ import annotations

from importlib import import_module

from experiments.run import Run
from experiments.scoring.tables import summarise
from experiments.scoring.typesetting import text


def main(run: Run, *methods: str) -> None:
    # The step of the track itself, without what it writes.
    evaluation, *_ = import_module(f"experiments.tracks.{run.track}").evaluations(run, methods)
    print(f"\n{run.model}, {run.preset.name} preset, seed {run.seed}\n")
    print(text(summarise(evaluation.metrics, **evaluation.table_options), run.track))
    print("The rest of the table follows.\n", flush=True)
