"""Write the report of a face model's results: `index.html` and `report.md`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from data_gen.models.registry import MODELS
from experiments.markup.markdown import markdown
from experiments.presets import PRESETS
from experiments.records import write_text
from experiments.report.experiment import REPORT, load_experiments, result_folders
from experiments.report.html import page
from experiments.report.overview import reports_elsewhere
from experiments.report.sections import report
from experiments.report.staleness import stale


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    add = parser.add_argument
    add("--model", choices=MODELS, default="openhead", help="face model of the results")
    add("--preset", choices=tuple(PRESETS), default="paper", help="sizes of the experiments")
    add("--results", type=Path, default=Path("results"), help="folder of all results")
    asked = parser.parse_args(arguments)
    root = asked.results if asked.preset == "paper" else asked.results / asked.preset
    folder = root / asked.model
    problems = stale(folder)
    if not result_folders(folder):
        problems.append(
            f"{folder} must hold results of experiments. Received none; run: "
            f"make reproduce-bfm MODEL={asked.model} PRESET={asked.preset}"
        )
    if problems:
        for problem in problems:
            print(f"error: {problem}", file=sys.stderr)
        raise SystemExit(2)
    blocks = report(asked.model, load_experiments(folder), reports_elsewhere(root))
    write_text(folder / REPORT / "report.md", markdown(blocks, folder / REPORT))
    write_text(folder / REPORT / "index.html", page(blocks))
    print(f"Report: {folder / REPORT / 'index.html'}")
