"""Step: print the table of the quick methods before the slow ones are trained."""

from dataclasses import replace
from importlib import import_module

from experiments.run import Run
from experiments.scoring.tables import summarise
from experiments.scoring.typesetting import text


def main(run: Run, *methods: str) -> None:
    # The step of the track itself, without output files, and without seeds: they come later.
    track = import_module(f"experiments.tracks.{run.track}")
    evaluation, *_ = track.evaluations(replace(run, seeds=None), methods)
    print(f"\n{run.model}, {run.preset.name} preset, seed {run.seed}\n")
    print(text(summarise(evaluation.metrics, **evaluation.table_options), run.track))
    print("The rest of the table follows.\n", flush=True)
