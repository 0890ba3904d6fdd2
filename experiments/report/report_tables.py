"""Tables that stand by themselves: parameters, variants, stages, and CSV files as they are."""

from __future__ import annotations

import pandas as pd

from experiments.lifting import hard_tables as tables
from experiments.lifting.study_tables import anatomy_cells, transfer_cells
from experiments.markup.markdown import Table
from experiments.methods import METHODS, title
from experiments.metrics import METRICS
from experiments.report import wording
from experiments.report.experiment import Experiment
from experiments.scoring.numbers import NOTHING, duration, moment, scientific
from experiments.scoring.parameters import HEADS
from experiments.studies import ablation

# Of a stage's record: what tables have of their own, or nobody asks for.
_NOT_SHOWN = {"stage", "command", "started", "seconds", "peak_memory_mb", "model", "model_sha256",
              "methods", "processes_mb", "rows", "tables"}  # fmt: skip
_HEADS = {"std": "s.d.", "mse": "MSE", "n_faces": "faces"}


def metric_head(metric: str) -> str:
    """Name of a metric in tables."""
    return METRICS[metric].head if metric in METRICS else metric.replace("_", " ")


def parameters_table(experiment: Experiment) -> Table:
    """The paper's table of parameters and complexity, ours beside it."""
    table = experiment.table()
    rows = pd.DataFrame({HEADS["method"]: table["method"].map(title)})
    for name, head in [(name, HEADS[name]) for name in HEADS if name in table][1:]:
        shown = "{:,.0f}" if name in ("trainable", "total") else "{:.3g}"
        rows[head] = [
            value if isinstance(value, str) else NOTHING if pd.isna(value) else shown.format(value)
            for value in table[name]
        ]
    caption = (
        "Trainable parameters here and as the paper prints them; in total, with the moving "
        "statistics of batch normalisation. n: landmarks, t: iterations, k: components of the face "
        "model."
    )
    return Table(caption, rows, tuple(head for head in rows if head.startswith("Complexity")))


def ablation_table(experiment: Experiment) -> Table:
    """Losses and errors of every variant: mean and s.d. over its seeds."""
    rows = pd.DataFrame(ablation.rows_of(experiment.table()), columns=[*ablation.HEADS.values()])
    return Table("Mean ± s.d. over the seeds.", rows)


def hard_tables(experiment: Experiment) -> list[Table]:
    """Errors by condition, their ratio to the limit, and what predicted s.d.s cover."""
    table = experiment.table()
    first, *others = tables.HEADS
    captions = {first: " ".join(tables.remarks(table))} | {m: tables.HEADS[m] for m in others}
    return [Table(caption, tables.cells(table, m)) for m, caption in captions.items()]


def study_table(experiment: Experiment) -> Table:
    """Errors of the anatomy or of the transfer."""
    caption, table = "Mean ± standard error.", experiment.table()
    if experiment.base == "lifting/anatomy":
        return Table(caption, anatomy_cells(table))
    rows = transfer_cells(table)
    return Table(caption, rows, words=tuple(rows.columns[:2]))


def plain_table(experiment: Experiment) -> Table:
    """A table as its CSV file has it."""
    table = experiment.table()
    words = [name for name in table if table[name].dtype.kind not in "if"]
    heads = {name: _HEADS.get(name, name.replace("_", " ")) for name in table}
    caption = wording.TABLES.get(experiment.base, "As in `table.csv`.")
    rows = table.map(_plain).rename(columns=heads)
    return Table(caption, rows, tuple(heads[name] for name in words))


def stages_table(experiment: Experiment) -> Table:
    """The stages of an experiment, and what they recorded."""
    rows = [
        {
            "Stage": record["stage"],
            "Begun (UTC)": moment(record["started"]),
            "Took": duration(record["seconds"]),
            "Memory (MB)": f"{record['peak_memory_mb']:,}",
            "Recorded": "; ".join(_recorded(record)),
            "Command": f"`{record['command']}`",
        }
        for record in experiment.manifest["stages"]
    ]
    return Table("Stages, in order.", pd.DataFrame(rows), ("Recorded", "Command"))


def _recorded(record: dict, prefix: str = "") -> list[str]:
    """Other entries of a stage's record, nested ones flattened."""
    found = []
    for key, value in record.items():
        if not prefix and key in _NOT_SHOWN:
            continue
        name = f"{prefix}{key}".replace("_", " ")
        if isinstance(value, dict):
            found += _recorded(value, f"{name}, ")
        elif isinstance(value, list):
            found.append(f"{name}: {', '.join(map(str, value))}")
        else:
            found.append(f"{name}: {value:,}" if isinstance(value, int) else f"{name}: {value}")
    return found


def _plain(value: str | float) -> str:
    """A cell of a CSV file: the name of a method or metric, or a number."""
    if isinstance(value, str):
        return title(value) if value in METHODS else metric_head(value)
    return f"{value:,}" if isinstance(value, int) else scientific(value)
