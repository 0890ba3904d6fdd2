"""Tables of the compared methods: the paper's criteria, ours, tests and single faces."""

from __future__ import annotations

import pandas as pd

from experiments.markup.markdown import Notes, Table
from experiments.methods import title
from experiments.metrics import METRICS
from experiments.published import unit_of
from experiments.report.experiment import Experiment
from experiments.scoring.numbers import (
    NOTHING,
    as_quoted,
    between,
    difference,
    minus,
    plus_minus,
    power,
)
from experiments.scoring.typesetting import columns_of, head_of

_OF_PAPER = "in the paper, "
_OF_CELL = ["mean", "std", "paper_mean", "paper_std"]


def criteria_table(experiment: Experiment) -> Table:
    """The paper's criteria: ours, the paper's and how they differ, of every method."""
    track = experiment.track
    criteria = [metric for metric in METRICS.values() if metric.in_paper]
    notes, rows = Notes(), []
    for method, cells in _by_method(experiment):
        common, own = _notes_of(cells.loc[[metric.id for metric in criteria]])
        row = {"Method": title(method) + notes.mark(common)}
        for metric in criteria:
            head, unit = head_of(metric, track), unit_of(track, metric.id)
            mean, std, paper, paper_std = cells.loc[metric.id, _OF_CELL]
            here, there = own[metric.id]
            row[f"{head}: here"] = plus_minus(mean, std, unit) + notes.mark(here)
            row[f"{head}: paper"] = as_quoted(paper, paper_std, unit) + notes.mark(there)
            row[f"{head}: difference"] = difference(mean, paper, unit)
            if metric.over_seeds and "n_seeds" in cells:
                row[f"{head}: seeds"] = between(
                    *cells.loc[metric.id, ["median", "lowest", "highest"]], unit
                )
        rows.append(row)
    subsets = experiment.table()[["n_subsets", "subset_size"]].dropna().astype(int)
    over = "".join(
        f", over {n} random subsets of {size:,} test faces"
        for n, size in subsets.drop_duplicates().itertuples(index=False)
    )
    caption = (
        f"The paper's criteria: mean ± s.d. here{over}. Beside it is what the paper prints, and "
        "how much more ours is, with how many times the paper's."
    )
    if "n_seeds" in experiment.table():
        caption += (
            " Seeds: median, lowest and highest over several trainings, each on faces of its own."
        )
    return Table(caption, pd.DataFrame(rows), notes=tuple(notes))


def other_criteria_table(experiment: Experiment) -> Table:
    """Table of all else that is measured of every method."""
    shown = columns_of(experiment.table(), experiment.track, "report")
    known = [metric.id for metric in shown if not metric.in_paper]
    notes, rows = Notes(), []
    for method, cells in _by_method(experiment):
        common, own = _notes_of(cells.loc[known])
        row = {"Method": title(method) + notes.mark(common)}
        for metric in known:
            number = plus_minus(*cells.loc[metric, ["mean", "std"]])
            row[METRICS[metric].head] = number + notes.mark(own[metric][0])
        rows.append(row)
    caption = "What the paper does not measure: mean ± s.d. here."
    return Table(caption, pd.DataFrame(rows), notes=tuple(notes))


def wilcoxon_table(experiment: Experiment, method: str = "ours") -> Table | None:
    """Wilcoxon's signed-rank tests of one method's MSE against every other's."""
    tests = experiment.table("wilcoxon.csv")
    tests = tests[
        (tests["metric"] == "mse") & (tests[["method_a", "method_b"]] == method).any(axis=1)
    ]
    if tests.empty:
        return None
    unit, rows = experiment.mse_unit, {}
    for test in tests.itertuples():
        second = test.method_a == method
        other = test.method_b if second else test.method_a
        row = rows.setdefault(other, {"Against": title(other)})
        # Of the method minus the other.
        median = test.median_difference / unit * (1 if second else -1)
        p = f"{test.p_value:.2g}" if test.p_value > 0 else "< 10⁻³⁰⁰"
        row[f"Over {test.over}: median ({power(unit)})"] = minus(f"{median:+.3g}")
        row[f"Over {test.over}: p"] = minus(p)
        row[f"Over {test.over}: n"] = f"{test.n:,.0f}"
    caption = (
        f"Wilcoxon's signed-rank test of {title(method)}'s MSE against each other row's: median of "
        "the differences and two-sided p-value, over faces that all methods found and over the "
        "random subsets. Subsets of one test set differ by resampling only."
    )
    table = pd.DataFrame([*rows.values()]).fillna(NOTHING)
    heads = sorted(table.columns[1:], key=lambda head: head.partition(":")[0])
    return Table(caption, table[["Against", *heads]])


def faces_table(experiment: Experiment, examples: dict) -> Table:
    """The error of every method on the faces that can be turned about."""
    unit, faces = experiment.mse_unit, examples["faces"]
    rows = pd.DataFrame({"Method": [*map(title, faces[0]["mse"])]})
    for face in faces:
        rows[face["title"]] = [
            "N/A" if error is None else f"{error / unit:#.3g}".rstrip(".")
            for error in face["mse"].values()
        ]
    return Table(f"MSE ({power(unit)}) of these faces. N/A: not found.", rows)


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
