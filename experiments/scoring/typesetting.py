"""A summary as it is read: a LaTeX table and a text for the terminal, of the same cells."""

from __future__ import annotations

import textwrap

import pandas as pd

from deepmds_keras.landmarks import load_scheme
from experiments.methods import title
from experiments.metrics import Metric, metrics_of
from experiments.published import unit_of
from experiments.run import SCHEMES
from experiments.scoring.latex import tabular
from experiments.scoring.numbers import NOTHING, as_quoted, between, plus_minus, power, rounded

_METHOD = ("", "Method")


def latex(table: pd.DataFrame, experiment: str) -> str:
    r"""The table to `\input`: methods by metrics, the paper's first, and below it what they are.

    Args:
        table: As from `tables.summarise`.
        experiment: `"bfm"`, `"celeba"` or `"flame"`: which of the paper's tables it stands beside.

    Raises:
        InputError: Unknown experiment.
    """
    metrics = columns_of(table, experiment, "latex")
    cells = _cells(table, experiment, metrics)
    columns = "l" + "r" * (cells.shape[1] - 1)
    return tabular(cells, columns, _remarks(table, experiment, metrics))


def text(table: pd.DataFrame, experiment: str) -> str:
    """The table for the terminal: the paper's metrics, the others, then what the columns are.

    Args:
        table, experiment: As for `latex`.

    Raises:
        InputError: Unknown experiment.
    """
    metrics = columns_of(table, experiment, "terminal")
    blocks = [
        _block(_cells(table, experiment, [m for m in metrics if m.in_paper == in_paper]))
        for in_paper in (True, False)
    ]
    width = blocks[0].index("\n")
    remarks = [
        textwrap.fill(remark, width, subsequent_indent="    ")
        for remark in _remarks(table, experiment, metrics)
    ]
    return "\n".join([*blocks, *remarks, ""])


def columns_of(table: pd.DataFrame, experiment: str, output: str) -> list[Metric]:
    """Metrics that an output shows, but for those registered after the table was made."""
    made = {*table["metric"]}
    return [m for m in metrics_of(experiment) if output in m.shown and m.id in made]


def head_of(metric: Metric, experiment: str) -> str:
    """Name of a metric, with its unit, in the tables of an experiment."""
    n, unit = n_landmarks(experiment), unit_of(experiment, metric.id)
    return metric.head + metric.scale.format(n=n, power=power(unit))


def n_landmarks(experiment: str) -> int:
    """Landmarks of a face in an experiment."""
    return len(load_scheme(SCHEMES[experiment]))


def _cells(table: pd.DataFrame, experiment: str, metrics: list[Metric]) -> pd.DataFrame:
    """Texts of every method, a row each, under heads of two levels."""
    by_metric = {metric: rows.set_index("method") for metric, rows in table.groupby("metric")}
    methods = table["method"].unique()
    cells = {_METHOD: [*map(title, methods)]}
    for metric in metrics:
        head, unit = head_of(metric, experiment), unit_of(experiment, metric.id)
        rows = by_metric[metric.id].loc[methods]
        ours = zip(rows["mean"], rows["std"], strict=True)
        if metric.in_paper:
            paper = zip(rows["paper_mean"], rows["paper_std"], strict=True)
            cells[head, "paper"] = [as_quoted(*of, unit) for of in paper]
            cells[head, "here"] = [plus_minus(*of, unit) for of in ours]
            if metric.over_seeds and "n_seeds" in rows:
                spread = zip(rows["median"], rows["lowest"], rows["highest"], strict=True)
                cells[head, "seeds"] = [between(*of, unit) for of in spread]
        else:
            cells[head, "here"] = [rounded(mean, metric.decimals) for mean, _ in ours]
    return pd.DataFrame(cells)


def _block(cells: pd.DataFrame) -> str:
    """Aligned, with the heads of groups over the last of their columns."""
    body = [[sub for _, sub in cells.columns], *cells.to_numpy().tolist()]
    widths = [max(map(len, column)) for column in zip(*body, strict=True)]
    top, first = " " * widths[0], 1
    while first < len(widths):
        head = cells.columns[first][0]
        last = max(k for k, (other, _) in enumerate(cells.columns) if other == head)
        room = sum(widths[first : last + 1]) + 2 * (last - first)
        widths[last] += max(0, len(head) - room)
        top += "  " + head.rjust(room)
        first = last + 1
    lines = [
        "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]) for row in body
    ]
    return "\n".join([top, lines[0], "-" * len(top), *lines[1:], ""])


def _remarks(table: pd.DataFrame, experiment: str, metrics: list[Metric]) -> list[str]:
    """Remarks: each column, over how many faces, then the notes of the cells shown."""
    n = n_landmarks(experiment)
    remarks = [f"{head_of(m, experiment)}: {m.definition(n)}." for m in metrics]
    subsets = table[["n_subsets", "subset_size"]].dropna().drop_duplicates()
    remarks += [
        f"Here: mean (± s.d.) over {n} random subsets of {size} test faces."
        for n, size in subsets.itertuples(index=False)
    ]
    remarks += [
        f"Seeds: median [lowest, highest] of {n:.0f} trainings, each on faces of its own, over all "
        "test faces."
        for n in (table["n_seeds"].dropna().unique() if "n_seeds" in table else ())
    ]
    remarks.append(f"Paper: quoted from Kamyab and Azimifar. {NOTHING}: no number.")
    shown = table[table["metric"].isin([metric.id for metric in metrics])]
    notes = shown.assign(note=shown["note"].fillna("").str.split("; ")).explode("note")
    for note, rows in notes[notes["note"] != ""].groupby("note", sort=False):
        remarks.append(f"{', '.join(map(title, rows['method'].unique()))}: {note}.")
    return remarks
