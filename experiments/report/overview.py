"""What the report says of all experiments together: glance, runs, what is missing, versions."""

from __future__ import annotations

import math
from collections import defaultdict
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.face_models import FACE_MODELS
from experiments.markup.blocks import Block, Cell, Column, Fold, Heading, Listing, Table
from experiments.report import wording
from experiments.report.experiment import COMMANDS, REPORT, Experiment
from experiments.report.report_tables import method_cell, metric_head, time_cell
from experiments.report.summaries import better_than_ours, measured
from experiments.scoring.numbers import (
    NOTHING,
    as_quoted,
    duration,
    factor,
    plus_minus,
    power,
    size,
)

_AT_A_GLANCE = ("bfm", "flame", "flame-true-landmarks", "celeba", "celeba-true-landmarks")


def heading_of(experiment: Experiment) -> str:
    """Its title, and what about it is not the default."""
    name = wording.EXPERIMENTS.get(experiment.base, (experiment.name, ""))[0]
    return f"{name} ({experiment.variant.replace('-', ' ')})" if experiment.variant else name


def at_a_glance(experiments: list[Experiment]) -> list[Block]:
    columns = (
        Column("Experiment", numeric=False),
        Column("here", "Deep-MDS, MSE"),
        Column("paper", "Deep-MDS, MSE"),
        Column("ratio", "Deep-MDS, MSE"),
        Column("Mean shape, MSE"),
        Column("Methods that err less"),
    )
    rows = []
    for own in experiments:
        if own.base not in _AT_A_GLANCE or not own.compared:
            continue
        mse = measured(own)
        if "ours" not in mse.index:
            continue
        ours, constant = mse.loc["ours"], mse["mean"].get("mean_shape", math.nan)
        better, others = better_than_ours(mse)
        unit = own.mse_unit
        ratio = ours["mean"] / ours["paper_mean"]
        times = f" × {power(unit)}"
        rows.append(
            (
                Cell(f"[{heading_of(own)}](#{own.name})"),
                Cell(f"({plus_minus(ours['mean'], ours['std'], unit)}){times}", ours["mean"]),
                _paper_cell(ours, unit, times),
                Cell(NOTHING if pd.isna(ratio) else f"×{factor(ratio)}", ratio),
                Cell(f"{plus_minus(constant, unit=unit)}{times}", constant),
                Cell(f"{len(better)} of {len(others)}", len(better)),
            )
        )
    if not rows:
        return []
    caption = (
        "Deep-MDS as the paper has it, one constant shape, and how many of the other methods on "
        "the same faces err less than Deep-MDS does."
    )
    return [Heading(2, "At a glance", "glance"), Table(caption, columns, tuple(rows))]


def _paper_cell(row: pd.Series, unit: float, times: str) -> Cell:
    if pd.isna(row["paper_mean"]):
        return Cell(NOTHING)
    quoted = as_quoted(row["paper_mean"], row["paper_std"], unit)
    return Cell(f"({quoted}){times}", row["paper_mean"])


def what_was_run(experiments: list[Experiment]) -> list[Block]:
    columns = tuple(
        Column(head, numeric=numeric)
        for head, numeric in (
            ("Experiment", False), ("Command", False), ("Preset", False), ("Seed", True),
            ("Begun (UTC)", True), ("Took", True), ("Memory (MB)", True), ("Commit", False),
        )
    )  # fmt: skip
    rows = []
    for own in experiments:
        made = own.manifest
        memory = max(record["peak_memory_mb"] for record in made["stages"])
        rows.append(
            (
                Cell(f"[{own.name}](#{own.name})"),
                Cell(f"`{made['command']}`"),
                Cell(made["preset"]["name"]),
                Cell(str(made["seed"]), made["seed"]),
                time_cell(made["started"]),
                Cell(duration(made["seconds"]), made["seconds"]),
                Cell(f"{memory:,}", memory),
                Cell(made["commit"] or NOTHING),
            )
        )
    caption = (
        "Each row's stages together, of which experiments share some; the most memory of any one. "
        "A commit with + had changes that were not committed."
    )
    sizes = {name: value for own in experiments for name, value in own.manifest["preset"].items()}
    sizes.pop("name", None)
    size_rows = tuple(
        (Cell(name.replace("_", " ")), Cell(size(value), np.max(value)))
        for name, value in sizes.items()
    )
    size_columns = (Column("Size", numeric=False), Column("Value"))
    size_table = Table("Sizes of the preset.", size_columns, size_rows)
    return [
        Heading(2, "What was run", "run"),
        Table(caption, columns, tuple(rows)),
        Fold("Sizes", (size_table,)),
    ]


def not_run(model: str, experiments: list[Experiment], elsewhere: dict[str, str]) -> list[Block]:
    present = {own.base for own in experiments}
    missing = [
        f"**{wording.EXPERIMENTS[base][0]}** (`{base}`): not run with this face model. "
        f"`{command} MODEL={model}` runs it."
        for base, command in COMMANDS.items()
        if base not in present
    ]
    models = [
        f"**{full}**: {elsewhere.get(name) or f'not run; {reason}.'}"
        for name, (full, reason) in FACE_MODELS.items()
        if name != model
    ]
    made_up = defaultdict(list)
    for own in experiments:
        for record in own.manifest["stages"]:
            for value in record.values():
                if isinstance(value, str) and value.startswith("stand-in"):
                    made_up[record["stage"], value].append(own.name)
    stand_ins = [
        f"**{wording.DATA_SETS.get(stage, stage)}**. {value.capitalize()}, in "
        f"{', '.join(f'`{name}`' for name in names)}."
        for (stage, value), names in made_up.items()
    ]
    blocks: list[Block] = [Heading(2, "What was not run, and why", "not-run")]
    for head, items in (
        ("Experiments", missing),
        ("Face models", models),
        ("Data sets that something else stands in for", stand_ins),
    ):
        if items:
            blocks += [
                Heading(3, head, f"not-run-{head.split()[0].lower()}"),
                Listing(tuple(items)),
            ]
    rows = _empty_cells(experiments)
    if rows:
        columns = [
            Column(head, numeric=False) for head in ("Method", "Cells", "Why", "Experiments")
        ]
        blocks += [
            Heading(3, "Empty cells", "not-run-cells"),
            Table("Cells of the tables without a number of ours.", tuple(columns), rows),
        ]
    return blocks


def _empty_cells(experiments: list[Experiment]) -> tuple[tuple[Cell, ...], ...]:
    """Method, experiments, metrics and the reason, which is the cells' note."""
    reasons = defaultdict(list)
    for own in experiments:
        table = own.table() if own.compared else pd.DataFrame({"mean": []})
        for cell in table[table["mean"].isna()].itertuples():
            parts = [p for p in str(cell.note).split("; ") if not p.startswith("in the paper, ")]
            parts = ["not measured" if p == f"{cell.metric} not measured" else p for p in parts]
            reasons[own.name, cell.method, "; ".join(parts)].append(cell.metric)
    rows = defaultdict(list)
    for (name, method, reason), metrics in reasons.items():
        cells = "all" if "mse" in metrics else ", ".join(map(metric_head, metrics))
        rows[method, cells, reason].append(name)
    return tuple(
        (method_cell(method), Cell(cells), Cell(reason), Cell(", ".join(f"`{n}`" for n in names)))
        for (method, cells, reason), names in rows.items()
    )


def environment(experiments: list[Experiment]) -> list[Block]:
    values: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    for own in experiments:
        made = own.manifest
        facts = {
            "Machine": made["platform"],
            "Processor": made.get("processor", "not recorded"),
            "Python": made["python"],
            **made["packages"],
            "Face model (sha256)": made["model_sha256"],
        }
        for name, value in facts.items():
            values[name][value].append(own.name)
    rows = [
        (
            Cell(name),
            Cell(
                "; ".join(
                    value if len(by_value) == 1 else f"{value} ({', '.join(owners)})"
                    for value, owners in by_value.items()
                )
            ),
        )
        for name, by_value in values.items()
    ]
    columns = (Column("What", numeric=False), Column("Version", numeric=False))
    return [
        Heading(2, "Environment", "environment"),
        Table("What computed the numbers.", columns, tuple(rows)),
    ]


def reports_elsewhere(results: Path) -> dict[str, str]:
    """What is to be said of the other face models that have results in `results/<model>`."""
    said = {}
    for model in FACE_MODELS:
        if (results / model / REPORT / "report.md").is_file():
            said[model] = f"[its own report](../../{model}/{REPORT}/report.md)."
        elif [*(results / model).glob("*/manifest.json")]:
            said[model] = f"run; `make report MODEL={model}` writes its own report."
    return said
