"""Typesets a table: its cells as texts, for LaTeX and for the terminal."""

import textwrap
from collections.abc import Mapping

import numpy as np
import pandas as pd

from experiments.methods import rows_of_paper, title
from experiments.scoring.latex import tabular, tex
from experiments.scoring.metrics import METRICS, Metric, metrics_of
from experiments.scoring.numbers import NOTHING, as_quoted, between, plus_minus, power, rounded
from experiments.scoring.published import paper_table, unit_of

_WIDTH = 96  # characters of a line of the terminal


def text(table: pd.DataFrame, experiment: str) -> str:
    """The table for the terminal: the paper's metrics, the others, then the definitions.

    Args:
        table: As from `tables.summarise`.
        experiment: `"bfm"`, `"celeba"` or `"flame"`: the paper's table to compare with.
    """
    shown = cells(table, experiment, "terminal").rename_axis(None)
    in_paper = [(head, "paper") in shown for head, _ in shown]
    blocks = [shown.loc[:, in_paper].to_string(), shown.loc[:, ~np.array(in_paper)].to_string()]
    lines = [
        textwrap.fill(remark, _WIDTH, subsequent_indent="    ")
        for remark in remarks(table, experiment, "terminal")
    ]
    return "\n\n".join([*blocks, "\n".join(lines)]) + "\n"


def latex(table: pd.DataFrame, experiment: str) -> str:
    r"""The table of `text` to `\input`, methods by metrics; below it the definitions."""
    shown = cells(table, experiment, "latex").reset_index(col_level=1)
    columns = "l" + "r" * (shown.shape[1] - 1)
    return tabular(shown, columns, remarks(table, experiment, "latex"))


def paper_layout(
    table: pd.DataFrame, experiment: str, faces: str, paper_rows: Mapping[str, str] = {}
) -> str:
    r"""The paper's own table as a LaTeX `table`: each cell has its number and, after /, ours.

    Args:
        table, experiment: As for `text`.
        faces: What the numbers of this table are about.
        paper_rows: As for `tables.summarise`.
    """
    shown, rows = cells(table, experiment, "latex"), rows_of_paper(paper_rows)
    n = n_landmarks(table)
    quoted = paper_table(experiment)
    ours = [
        shown.loc[title(rows[cell.method]), (head_of(METRICS[cell.metric], experiment, n), "here")]
        for cell in quoted.itertuples()
    ]
    texts = quoted.assign(text=quoted["printed"] + " / " + ours)
    layout = texts.pivot_table("text", "row", "column", "first", sort=False)
    layout = layout.rename_axis(index="Paper / here", columns=None).reset_index()
    (label,) = quoted["table"].unique()
    caption = tex(f"The paper's table; after each slash that of one training, on {faces}.")
    body = tabular(layout, "l" + "c" * (layout.shape[1] - 1))
    lines = (r"\begin{table}", r"\centering", body.rstrip(), rf"\caption{{{caption}}}")
    return "\n".join([*lines, rf"\label{{{label}}}", r"\end{table}", ""])


def cells(table: pd.DataFrame, experiment: str, output: str) -> pd.DataFrame:
    """Texts of a table: methods by columns with two levels, the metric and its statistic.

    Table and experiment are as for `text`; the output is `"terminal"` or `"latex"`, which has fewer
    columns.
    """
    methods, columns, n = table["method"].unique(), {}, n_landmarks(table)
    for metric in _metrics_shown(table, experiment, output):
        head, unit = head_of(metric, experiment, n), unit_of(experiment, metric.id)
        rows = table[table["metric"] == metric.id].set_index("method").loc[methods]
        if not metric.in_paper:
            columns[head, "here"] = [rounded(mean, metric.decimals) for mean in rows["mean"]]
            continue
        paper = zip(rows["paper_mean"], rows["paper_std"], strict=True)
        columns[head, "paper"] = [as_quoted(*number, unit) for number in paper]
        here = zip(rows["mean"], rows["std"], strict=True)
        columns[head, "here"] = [plus_minus(*number, unit) for number in here]
        if metric.over_seeds and "n_seeds" in rows:
            ranges = zip(rows["median"], rows["lowest"], rows["highest"], strict=True)
            columns[head, "seeds"] = [between(*number, unit) for number in ranges]
    return pd.DataFrame(columns, index=pd.Index(map(title, methods), name="Method"))


def remarks(table: pd.DataFrame, experiment: str, output: str) -> list[str]:
    """Sentences below the table: on each column, on the faces, and the notes on cells."""
    metrics, n = _metrics_shown(table, experiment, output), n_landmarks(table)
    sentences = [f"{head_of(m, experiment, n)}: {m.definition(n)}." for m in metrics]
    subsets = table[["n_subsets", "subset_size"]].dropna().drop_duplicates().astype(int)
    sentences += [
        f"Here: mean (± s.d.) over {n} random subsets of {size} test faces."
        for n, size in subsets.itertuples(index=False)
    ]
    sentences += [
        f"Seeds: median [lowest, highest] of {n:.0f} trainings, each on its own faces, over all "
        "test faces."
        for n in (table["n_seeds"].dropna().unique() if "n_seeds" in table else ())
    ]
    sentences.append(f"Paper: quoted from Kamyab and Azimifar. {NOTHING}: no number.")
    shown = table[table["metric"].isin([metric.id for metric in metrics])]
    notes = shown.assign(note=shown["note"].fillna("").str.split("; ")).explode("note")
    for note, rows in notes[notes["note"] != ""].groupby("note", sort=False):
        sentences.append(f"{'; '.join(map(title, rows['method'].unique()))}: {note}.")
    return sentences


def head_of(metric: Metric, experiment: str, n_landmarks: int) -> str:
    """Name of a metric, with its unit, in the tables of an experiment."""
    unit = unit_of(experiment, metric.id)
    return metric.head + metric.scale.format(n=n_landmarks, power=power(unit))


def n_landmarks(table: pd.DataFrame) -> int:
    """Landmarks of a face in a table."""
    return int(table["n_landmarks"].iloc[0])


def _metrics_shown(table: pd.DataFrame, experiment: str, output: str) -> list[Metric]:
    """Metrics that an output shows, except those registered after the table was made."""
    present = {*table["metric"]}
    return [m for m in metrics_of(experiment) if output in m.shown and m.id in present]
