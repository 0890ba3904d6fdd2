"""Write the report of a face model's results: `index.html` and `report.md`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from data_gen.models.registry import MODELS
from experiments.presets import PRESETS
from experiments.records import write_text
from experiments.report.experiment import REPORT, load_experiments, result_folders
from experiments.report.overview import reports_elsewhere
from experiments.report.page import page
from experiments.report.sections import colour_of, faces, report
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
    experiments, folder = load_experiments(folder), folder / REPORT
    text = report(asked.model, experiments, reports_elsewhere(root))
    write_text(folder / "report.md", text)
    write_text(folder / "index.html", page(text, folder, faces(experiments), colour_of))
    print(f"Report: {folder / 'index.html'}")
