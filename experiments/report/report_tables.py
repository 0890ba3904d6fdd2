"""Tables of the report, from the tables that experiments wrote."""

from __future__ import annotations

import datetime
import math

import pandas as pd

from experiments.figures.style import colour
from experiments.markup.blocks import Cell, Column, Table
from experiments.methods import BY_ID, title
from experiments.report.experiment import Experiment
from experiments.scoring.numbers import (
    NOTHING,
    as_quoted,
    difference,
    minus,
    moment,
    plus_minus,
    power,
    scientific,
)
from experiments.studies.ablation import HEADS, rows_of

_CRITERIA = {"mse": "MSE", "depth_corr": "Depth correlation"}
_OF_PAPER = "in the paper, "
_OTHERS = {
    "mse_mm2": "MSE (mm²)",
    "rmse_mm": "RMSE (mm)",
    "depth_corr_across_faces": "Across faces",
    "mirrored_fraction": "Mirrored",
    "found_fraction": "Found",
    "ms_per_face": "ms a face",
    "n_parameters": "Parameters",
}
# As in `experiments.scoring.parameters`, which would load Keras.
_PARAMETERS = {
    "trainable": "Trainable",
    "total": "Total",
    "paper": "Trainable (paper)",
    "complexity_paper": "Complexity (paper)",
    "complexity": "Complexity",
    "ms_per_face": "ms a face",
}
_HEADS = {"std": "s.d.", "mse": "MSE", "n_faces": "faces"}


class _Notes:
    """Notes of a table, each written once and numbered from 1."""

    def __init__(self):
        self.texts: list[str] = []

    def numbers(self, notes: list[str]) -> tuple[int, ...]:
        self.texts += [note for note in dict.fromkeys(notes) if note not in self.texts]
        return tuple(sorted(self.texts.index(note) + 1 for note in notes))


def method_cell(method: str, notes: tuple[int, ...] = ()) -> Cell:
    """First cell of a row: the method's title, in the colour that figures have it in."""
    return Cell(title(method), notes=notes, colour=colour(method))


def time_cell(iso: str) -> Cell:
    """Date and time of day, by which a table is sorted."""
    return Cell(moment(iso), datetime.datetime.fromisoformat(iso).timestamp())


def metric_head(metric: str) -> str:
    """Name of a metric in tables."""
    return (_CRITERIA | _OTHERS).get(metric, metric.replace("_", " "))


def criteria_table(experiment: Experiment) -> Table:
    """The paper's criteria: ours, the paper's and how they differ, of every method."""
    units = {"mse": experiment.mse_unit, "depth_corr": 1.0}
    groups = {
        metric: f"{head} ({power(units[metric])})" if units[metric] != 1 else head
        for metric, head in _CRITERIA.items()
    }
    columns = [Column("Method", numeric=False)]
    columns += [
        Column(head, group) for group in groups.values() for head in ("here", "paper", "difference")
    ]
    notes, rows = _Notes(), []
    for method, cells in _by_method(experiment):
        common, own = _notes_of(cells.loc[[*_CRITERIA]])
        row = [method_cell(method, notes.numbers(common))]
        for metric, unit in units.items():
            cell = cells.loc[metric]
            mean, std, paper, paper_std = cell[["mean", "std", "paper_mean", "paper_std"]]
            here, there = own[metric]
            row += [
                Cell(plus_minus(mean, std, unit), mean, notes.numbers(here)),
                Cell(as_quoted(paper, paper_std, unit), paper, notes.numbers(there)),
                Cell(difference(mean, paper, unit), mean - paper),
            ]
        rows.append(tuple(row))
    subsets = experiment.table()[["n_subsets", "subset_size"]].dropna().astype(int)
    over = "".join(
        f", over {n} random subsets of {size:,} test faces"
        for n, size in subsets.drop_duplicates().itertuples(index=False)
    )
    caption = (
        f"The paper's criteria: mean ± s.d. here{over}; as the paper prints them; and how much "
        "more ours is, with how many times the paper's."
    )
    return Table(caption, tuple(columns), tuple(rows), tuple(notes.texts))


def other_criteria_table(experiment: Experiment) -> Table:
    """What else is measured of every method."""
    known = [m for m in dict.fromkeys(experiment.table()["metric"]) if m not in _CRITERIA]
    columns = [Column("Method", numeric=False)]
    columns += [Column(metric_head(metric)) for metric in known]
    notes, rows = _Notes(), []
    for method, cells in _by_method(experiment):
        common, own = _notes_of(cells.loc[known])
        row = [method_cell(method, notes.numbers(common))]
        for metric in known:
            mean, std = cells.loc[metric, ["mean", "std"]]
            numbers = notes.numbers(own[metric][0])
            row.append(Cell(plus_minus(mean, std), mean, numbers))
        rows.append(tuple(row))
    caption = "What the paper does not measure: mean ± s.d. here."
    return Table(caption, tuple(columns), tuple(rows), tuple(notes.texts))


def wilcoxon_table(experiment: Experiment, method: str = "ours") -> Table | None:
    """Wilcoxon's signed-rank tests of one method's MSE against every other's."""
    tests = experiment.table("wilcoxon.csv")
    tests = tests[(tests["metric"] == "mse")]
    tests = tests[(tests["method_a"] == method) | (tests["method_b"] == method)]
    if tests.empty:
        return None
    second = tests["method_a"] == method
    tests = tests.assign(
        other=tests["method_b"].where(second, tests["method_a"]),
        # Of the method minus the other.
        median=tests["median_difference"].where(second, -tests["median_difference"]),
    )
    unit = experiment.mse_unit
    columns = [Column("Against", numeric=False)]
    rows = []
    for over in ("faces", "subsets"):
        columns += [Column(head, f"Over {over}") for head in (f"median ({power(unit)})", "p", "n")]
    for other, pairs in tests.groupby("other", sort=False):
        row = [method_cell(other)]
        for over in ("faces", "subsets"):
            pair = pairs[pairs["over"] == over]
            for value, text in (
                ("median", lambda x: minus(f"{x / unit:+.3g}")),
                ("p_value", lambda x: minus(f"{x:.2g}") if x > 0 else "< 10⁻³⁰⁰"),
                ("n", lambda x: f"{x:,.0f}"),
            ):
                number = pair[value].iloc[0] if len(pair) else float("nan")
                row.append(Cell(NOTHING if pd.isna(number) else text(number), number))
        rows.append(tuple(row))
    caption = (
        f"Wilcoxon's signed-rank test of {title(method)}'s MSE against each other row's: median of "
        "the differences and two-sided p-value, over faces that all methods found and over the "
        "random subsets. Subsets of one test set differ by resampling only."
    )
    return Table(caption, tuple(columns), tuple(rows))


def parameters_table(experiment: Experiment) -> Table:
    """The paper's table of parameters and complexity, ours beside it."""
    table = experiment.table().astype({"trainable": float, "total": float})
    columns = [Column("Method", numeric=False)]
    columns += [
        Column(head, numeric=not name.startswith("complexity"))
        for name, head in _PARAMETERS.items()
    ]
    rows = []
    for record in table.to_dict("records"):
        row = [method_cell(record["method"])]
        for name in _PARAMETERS:
            value = record[name]
            if isinstance(value, str):
                number = value.replace(",", "").strip("> ")
                row.append(Cell(value, float(number) if number.isdigit() else math.nan))
            else:
                text = f"{value:,.0f}" if name in ("trainable", "total") else f"{value:.3g}"
                row.append(Cell(NOTHING if pd.isna(value) else text, value))
        rows.append(tuple(row))
    caption = (
        "Trainable parameters here and as the paper prints them; in total, with the moving "
        "statistics of batch normalisation. n: landmarks, t: iterations, k: components of the face "
        "model."
    )
    return Table(caption, tuple(columns), tuple(rows))


def ablation_table(experiment: Experiment) -> Table:
    """Losses and errors of every variant: mean and s.d. over its seeds."""
    columns = [Column(head, numeric=name != "variant") for name, head in HEADS.items()]
    rows = tuple(tuple(map(Cell, row)) for row in rows_of(experiment.table()))
    return Table("Mean ± s.d. over the seeds.", tuple(columns), rows)


def plain_table(experiment: Experiment, caption: str) -> Table:
    """A table as its CSV file has it."""
    table = experiment.table()
    columns = [
        Column(_HEADS.get(name, name.replace("_", " ")), numeric=table[name].dtype.kind in "if")
        for name in table
    ]
    rows = []
    for record in table.to_dict("records"):
        cells = []
        for value in record.values():
            if isinstance(value, str):
                cells.append(method_cell(value) if value in BY_ID else Cell(metric_head(value)))
            else:
                shown = f"{value:,}" if isinstance(value, int) else scientific(value)
                cells.append(Cell(shown, value))
        rows.append(tuple(cells))
    return Table(caption, tuple(columns), tuple(rows))


def _by_method(experiment: Experiment):
    """Method and its rows of the table, by metric."""
    for method, cells in experiment.table().groupby("method", sort=False):
        yield method, cells.set_index("metric")


def _notes_of(cells: pd.DataFrame) -> tuple[list[str], dict[str, tuple[list[str], list[str]]]]:
    """Notes that all cells of a method share, and of each metric those on ours and the paper's."""
    parts = {
        metric: [part for part in str(note).split("; ") if part] if pd.notna(note) else []
        for metric, note in cells["note"].items()
    }
    on_ours = {m: [n for n in own if not n.startswith(_OF_PAPER)] for m, own in parts.items()}
    # A cell that was not measured has a note of its own instead.
    measured = [m for m in on_ours if pd.notna(cells.loc[m, "mean"])] or [*on_ours]
    common = [n for n in on_ours[measured[0]] if all(n in on_ours[m] for m in measured)]
    return common, {
        metric: (
            [note for note in on_ours[metric] if note not in common],
            [note.removeprefix(_OF_PAPER) for note in own if note.startswith(_OF_PAPER)],
        )
        for metric, own in parts.items()
    }
