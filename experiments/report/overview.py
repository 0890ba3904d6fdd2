"""Sections of the report on all experiments together: glance, runs, what is missing, versions."""

from __future__ import annotations

import math
from collections import defaultdict
from pathlib import Path

import pandas as pd

from experiments.face_models import FACE_MODELS
from experiments.markup.markdown import Table
from experiments.methods import title
from experiments.report import wording
from experiments.report.experiment import COMMANDS, REPORT, Experiment
from experiments.report.report_tables import metric_head
from experiments.report.summaries import better_than_ours, error, measured, printed
from experiments.scoring.numbers import (
    NOTHING,
    duration,
    factor,
    moment,
    plus_minus,
    power,
    size,
)

_AT_A_GLANCE = ("bfm", "flame", "flame-true-landmarks", "celeba", "celeba-true-landmarks")


def heading_of(experiment: Experiment) -> str:
    """Its title, and what about it is not the default."""
    name = wording.EXPERIMENTS.get(experiment.base, (experiment.name, ""))[0]
    return f"{name} ({experiment.variant.replace('-', ' ')})" if experiment.variant else name


def at_a_glance(experiments: list[Experiment]) -> Table | None:
    """The paper's method in every table of the paper that there is."""
    rows = []
    for own in experiments:
        if own.base not in _AT_A_GLANCE or not own.compared or "ours" not in measured(own).index:
            continue
        mse, unit = measured(own), own.mse_unit
        ours, constant = mse.loc["ours"], mse["mean"].get("mean_shape", math.nan)
        better, others = better_than_ours(mse)
        ratio = ours["mean"] / ours["paper_mean"]
        rows.append(
            {
                "Experiment": f"[{heading_of(own)}](#{own.name})",
                "Deep-MDS, MSE: here": error(ours, unit),
                "Deep-MDS, MSE: paper": printed(ours, unit),
                "Deep-MDS, MSE: ratio": NOTHING if pd.isna(ratio) else f"×{factor(ratio)}",
                "Mean shape, MSE": f"{plus_minus(constant, unit=unit)} × {power(unit)}",
                "Methods that err less": f"{len(better)} of {len(others)}",
            }
        )
    caption = (
        "Deep-MDS as the paper has it, one constant shape, and how many of the other methods on "
        "the same faces err less than Deep-MDS does. Over seeds: the median and the range."
    )
    return Table(caption, pd.DataFrame(rows)) if rows else None


def runs(experiments: list[Experiment]) -> Table:
    """Commands, times and memory."""
    rows = [
        {
            "Experiment": f"[{own.name}](#{own.name})",
            "Command": f"`{own.manifest['command']}`",
            "Preset": own.manifest["preset"]["name"],
            "Seed": own.manifest["seed"],
            "Begun (UTC)": moment(own.manifest["started"]),
            "Took": duration(own.manifest["seconds"]),
            "Memory (MB)": f"{max(s['peak_memory_mb'] for s in own.manifest['stages']):,}",
            "Commit": own.manifest["commit"] or NOTHING,
        }
        for own in experiments
    ]
    caption = (
        "Each row's stages together, of which experiments share some; the most memory of any one. "
        "A commit with + had changes that were not committed."
    )
    return Table(caption, pd.DataFrame(rows), ("Command", "Preset", "Commit"))


def sizes(experiments: list[Experiment]) -> Table:
    """Sizes of the preset."""
    found = {name: value for own in experiments for name, value in own.manifest["preset"].items()}
    rows = [(name.replace("_", " "), size(found[name])) for name in found if name != "name"]
    return Table("Sizes of the preset.", pd.DataFrame(rows, columns=["Size", "Value"]))


def not_run(
    model: str, experiments: list[Experiment], elsewhere: dict[str, str]
) -> dict[str, list[str]]:
    """Experiments, face models and data sets without results of their own, by heading."""
    present = {own.base for own in experiments}
    stand_ins = defaultdict(list)
    for own in experiments:
        for record in own.manifest["stages"]:
            for value in record.values():
                if isinstance(value, str) and value.startswith("stand-in"):
                    stand_ins[record["stage"], value].append(f"`{own.name}`")
    return {
        "Experiments": [
            f"**{wording.EXPERIMENTS[base][0]}** (`{base}`): not run with this face model. "
            f"`{command} MODEL={model}` runs it."
            for base, command in COMMANDS.items()
            if base not in present
        ],
        "Face models": [
            f"**{full}**: {elsewhere.get(name) or f'not run; {reason}.'}"
            for name, (full, reason) in FACE_MODELS.items()
            if name != model
        ],
        "Data sets that something else stands in for": [
            f"**{wording.DATA_SETS.get(stage, stage)}**. {value.capitalize()}, in "
            f"{', '.join(names)}."
            for (stage, value), names in stand_ins.items()
        ],
    }


def empty_cells(experiments: list[Experiment]) -> Table | None:
    """Cells without a number of ours, and the reason, which is the cells' note."""
    reasons = defaultdict(list)
    for own in experiments:
        table = own.table() if own.compared else pd.DataFrame({"mean": []})
        for cell in table[table["mean"].isna()].itertuples():
            parts = [p for p in str(cell.note).split("; ") if not p.startswith("in the paper, ")]
            parts = ["not measured" if p == f"{cell.metric} not measured" else p for p in parts]
            reasons[own.name, cell.method, "; ".join(parts)].append(cell.metric)
    found = defaultdict(list)
    for (name, method, reason), metrics in reasons.items():
        cells = "all" if "mse" in metrics else ", ".join(map(metric_head, metrics))
        found[title(method), cells, reason].append(f"`{name}`")
    rows = [(*key, ", ".join(names)) for key, names in found.items()]
    heads = ["Method", "Cells", "Why", "Experiments"]
    caption = "Cells of the tables without a number of ours."
    return Table(caption, pd.DataFrame(rows, columns=heads), tuple(heads)) if rows else None


def environment(experiments: list[Experiment]) -> Table:
    """Machine, packages and face model, and which experiments had another one."""
    made = {own.name: own.manifest for own in experiments}
    facts = pd.DataFrame(
        [
            {
                "Machine": own["platform"],
                "Processor": own.get("processor", "not recorded"),
                "Python": own["python"],
                **own["packages"],
                "Face model (sha256)": own["model_sha256"],
            }
            for own in made.values()
        ],
        index=[*made],
    )
    rows = []
    for name, column in facts.items():
        values = column.groupby(column, sort=False)
        owners = (
            f"{value} ({', '.join(own.index)})" if values.ngroups > 1 else value
            for value, own in values
        )
        rows.append((name, "; ".join(owners)))
    heads = ["What", "Version"]
    return Table("What computed the numbers.", pd.DataFrame(rows, columns=heads), tuple(heads))


def reports_elsewhere(results: Path) -> dict[str, str]:
    """Sentences on the other face models that have results in `results/<model>`."""
    said = {}
    for model in FACE_MODELS:
        if (results / model / REPORT / "report.md").is_file():
            said[model] = f"[its own report](../../{model}/{REPORT}/report.md)."
        elif [*(results / model).glob("*/manifest.json")]:
            said[model] = f"run; `make report MODEL={model}` writes its own report."
    return said
