"""Time every part of the method beside the released way, and its growth with the size of the task.

Everything runs in this one process on one core, but for the rows of several processes or threads,
and for the training steps: those are timed in a process of their own, with the threads of training.
"""

from __future__ import annotations

import os
from pathlib import Path

import pandas as pd

from experiments.arguments import parse_run
from experiments.bench.measurements import RATIOS, measure, table_of
from experiments.bench.mobileface_steps import mobileface_rows
from experiments.bench.step_times import in_own_process
from experiments.figures import bench_times as figures
from experiments.figures.style import save
from experiments.manifest import clear_results, records_of, write_manifest
from experiments.progress import Bar
from experiments.records import write_text
from experiments.run import Run
from experiments.running import single_threaded, stage
from experiments.scoring.latex import plain_tabular
from experiments.scoring.numbers import factor
from experiments.scoring.tables import write_csv

_ONE_THREAD = {"TF_NUM_INTRAOP_THREADS": "1", "TF_NUM_INTEROP_THREADS": "1"}


def measure_all(run: Run) -> tuple[pd.DataFrame, pd.DataFrame, str]:
    """The table of times, that of the two solvers' agreement, and the face model's hash."""
    training = in_own_process(run) + mobileface_rows(run)
    os.environ |= _ONE_THREAD
    with single_threaded():
        rows, agreed, digest = measure_parts(run)
    return table_of(rows + training), agreed, digest


def measure_parts(run: Run) -> tuple[list[dict], pd.DataFrame, str]:
    """Rows of all but the training steps, the solvers' agreement, and the face model's hash."""
    # TensorFlow reads how many threads it may use when it is loaded.
    from experiments.bench import agreement, growth, parts
    from experiments.bench.workload import make_workload

    workload = make_workload(run)
    # The growth with faces is last: what was measured before tells which rows would take too long.
    pieces = {
        "parts": parts.comparisons,
        "one face": parts.one_by_one,
        "landmarks": growth.with_landmarks,
        "jobs": growth.with_jobs,
        "faces": growth.with_faces,
    }
    rows: list[dict] = []
    with Bar(desc="bench", unit="row") as bar:
        for comparison, ways_of in pieces.items():
            bar.set_postfix_str(comparison)
            for ways in ways_of(workload):
                rows += measure(comparison, ways, run.preset.bench_passes, rows)
                bar.update(len(ways))
        bar.set_postfix_str("agreement")
        agreed = []
        for model, experiment, method, matrices in agreement.cases(workload):
            case = {"model": model, "experiment": experiment, "method": method}
            agreed.append(case | agreement.compare(matrices))
            bar.update()
    table = pd.DataFrame(agreed, columns=list(agreement.COLUMNS))
    return rows, table, workload.model.sha256


def results_folder(run: Run) -> Path:
    """One for all face models."""
    return run.model_results.parent / "bench"


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    folder = results_folder(run)
    with stage(run, "bench") as record:
        table, agreed, record["model_sha256"] = measure_all(run)
        clear_results(folder)
        write_csv(folder / "bench.csv", table)
        write_csv(folder / "agreement.csv", agreed)
        write_text(folder / "bench.tex", plain_tabular(table.drop(columns=["seconds", "note"])))
        save(figures.bench(table), folder / "figures", "bench")
    write_manifest(run, "bench", records_of(run, "bench"), folder)
    print(f"\n{summary(table)}\n\n{agreed.to_string(index=False)}")
    print(f"\nTables, figure and manifest: {folder}/")


def summary(table: pd.DataFrame) -> str:
    """The rows as they are read on a terminal."""
    shown = (
        table.drop(columns=["seconds", "note"])
        .astype(object)
        .rename(columns={"peak_memory_mb": "MB"})
    )
    for column in ("ms_per_face", *RATIOS):
        shown[column] = [factor(value) if value == value else "" for value in shown[column]]
    return shown.fillna("").to_string(index=False)
