"""A summary as it is read: a LaTeX `tabular` and a text for the terminal, of the same cells."""

from __future__ import annotations

import math
import re
import textwrap
from dataclasses import dataclass

import pandas as pd

from deepmds_keras.io.errors import InputError
from experiments.methods import title

NOTHING = "--"

_LATEX_CHARACTERS = {c: rf"\{c}" for c in "&%$#_{}"} | {
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "\\": r"\textbackslash{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "±": r"$\pm$",
    "×": r"$\times$",
}


@dataclass(frozen=True)
class _Column:
    """A metric as it is shown; one that the paper has gets two columns, paper and here."""

    metric: str
    head: str
    legend: str
    exponent: int = 0
    quoted: bool = False
    in_latex: bool = True

    @property
    def subheads(self) -> list[str]:
        return ["paper", "here"] if self.quoted else ["here"]


# How the paper prints an experiment's table: number of landmarks, power of ten of its MSE.
_LAYOUTS = {"bfm": (72, -4), "celeba": (72, -5), "flame": (51, -3)}


def latex(table: pd.DataFrame, experiment: str) -> str:
    r"""The table as a booktabs `tabular` to `\input`: methods by criteria, the paper's first.

    Args:
        table: As from `tables.summarise`.
        experiment: `"bfm"`, `"celeba"` or `"flame"`: which of the paper's tables it stands beside.

    Raises:
        InputError: Unknown experiment.
    """
    columns = [column for column in _columns(experiment) if column.in_latex]
    heads, rules, first = [], [], 2
    for column in columns:
        width = len(column.subheads)
        heads.append(rf"\multicolumn{{{width}}}{{c}}{{{tex(column.head)}}}")
        rules.append(rf"\cmidrule(lr){{{first}-{first + width - 1}}}")
        first += width
    subheads = ["Method", *(s for column in columns for s in column.subheads)]
    lines = [
        r"{\footnotesize\setlength{\tabcolsep}{3pt}%",
        rf"\begin{{tabular}}{{@{{}}l{'r' * (len(subheads) - 1)}@{{}}}}",
        r"\toprule",
        " & ".join(["", *heads]).lstrip() + r" \\",
        "".join(rules),
        " & ".join(subheads) + r" \\",
        r"\midrule",
        *(" & ".join(map(tex, row)) + r" \\" for row in _rows(table, columns)),
        r"\bottomrule",
    ]
    below = rf"\multicolumn{{{len(subheads)}}}{{@{{}}p{{0.98\linewidth}}@{{}}}}{{"
    remarks = [rf"{below}{tex(remark)}}} \\" for remark in _remarks(table, columns)]
    return "\n".join([*lines, *remarks, r"\end{tabular}}", ""])


def text(table: pd.DataFrame, experiment: str) -> str:
    """The table for the terminal: the paper's criteria, the others, then what the columns are.

    Args:
        table, experiment: As for `latex`.

    Raises:
        InputError: Unknown experiment.
    """
    columns = _columns(experiment)
    blocks = [
        _block(table, [column for column in columns if column.quoted == quoted])
        for quoted in (True, False)
    ]
    width = blocks[0].index("\n")
    remarks = [
        textwrap.fill(remark, width, subsequent_indent="    ")
        for remark in _remarks(table, columns)
    ]
    return "\n".join([*blocks, *remarks, ""])


def _block(table: pd.DataFrame, columns: list[_Column]) -> str:
    """Some columns of the table, aligned."""
    body = [["method", *(s for c in columns for s in c.subheads)], *_rows(table, columns)]
    widths = [max(map(len, cells)) for cells in zip(*body, strict=True)]
    top, first = " " * widths[0], 1
    for column in columns:
        last = first + len(column.subheads) - 1
        room = sum(widths[first : last + 1]) + 2 * (last - first)
        widths[last] += max(0, len(column.head) - room)
        top += "  " + column.head.rjust(room)
        first = last + 1
    lines = [
        "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]) for row in body
    ]
    return "\n".join([top, lines[0], "-" * len(top), *lines[1:], ""])


def tex(string: str) -> str:
    """Text with LaTeX's special characters escaped, and ±, × and powers as mathematics."""
    powers = re.split(r"\^(\d)", string)
    powers[::2] = ["".join(_LATEX_CHARACTERS.get(c, c) for c in part) for part in powers[::2]]
    powers[1::2] = [f"$^{digit}$" for digit in powers[1::2]]
    return "".join(powers)


def _columns(experiment: str) -> list[_Column]:
    if experiment not in _LAYOUTS:
        raise InputError(
            f"experiment must be one of {', '.join(_LAYOUTS)}. Received {experiment!r}."
        )
    n_landmarks, exponent = _LAYOUTS[experiment]
    return [
        _Column(
            "depth_corr",
            f"depth corr. (of {n_landmarks})",
            "trace of the landmarks' correlation matrix (the paper's avgDepthCorr), "
            f"at most {n_landmarks}, higher is better",
            quoted=True,
        ),
        _Column(
            "mse",
            f"MSE (×1e{exponent})",
            "mean square over coordinates (the paper's avgMSE) after Procrustes alignment, in "
            "squares of the min-max unit of a face, lower is better",
            exponent=exponent,
            quoted=True,
        ),
        _Column("rmse_mm", "RMSE (mm)", "root of the mean square in millimetres, a coordinate"),
        _Column(
            "depth_corr_across_faces",
            "across faces",
            "sum over landmarks of the correlation of depth across faces, "
            f"at most {n_landmarks}, higher is better",
        ),
        _Column("mirrored_fraction", "mirrored", "share of faces mirrored", in_latex=False),
        _Column("ms_per_face", "ms/face", "time of a prediction", in_latex=False),
        _Column("n_parameters", "parameters", "trainable parameters", in_latex=False),
    ]


def _rows(table: pd.DataFrame, columns: list[_Column]) -> list[list[str]]:
    """Title and cells of every method."""
    cells = table.set_index(["method", "metric"])
    rows = []
    for method in table["method"].unique():
        row = [title(method)]
        for column in columns:
            cell = cells.loc[(method, column.metric)]
            if column.quoted:
                row.append(_quoted(cell["paper_mean"], cell["paper_std"], column.exponent))
            row.append(_measured(cell["mean"], cell["std"], column))
        rows.append(row)
    return rows


def _quoted(mean: float, std: float, exponent: int) -> str:
    """With the digits that the paper gives, not more."""
    numbers = [f"{x / 10.0**exponent:.6g}" for x in (mean, std) if not math.isnan(x)]
    return " ± ".join(numbers) or NOTHING


def _measured(mean: float, std: float, column: _Column) -> str:
    """Mean, and in the paper's columns s.d., to the first digit of the s.d. (2 to 4 decimals)."""
    if math.isnan(mean):
        return NOTHING
    if column.metric == "n_parameters":
        return f"{mean:,.0f}"
    mean, std = mean / 10.0**column.exponent, std / 10.0**column.exponent
    if math.isnan(std) or not column.quoted:
        return f"{mean:.2f}"
    decimals = min(max(2, -math.floor(math.log10(std))), 4) if std > 0 else 2
    return f"{mean:.{decimals}f} ± {std:.{decimals}f}"


def _remarks(table: pd.DataFrame, columns: list[_Column]) -> list[str]:
    """What each column is, over how many faces, then the notes of the cells shown."""
    remarks = [f"{column.head}: {column.legend}." for column in columns]
    subsets = table[["n_subsets", "subset_size"]].dropna().drop_duplicates()
    remarks += [
        f"Here: mean (± s.d.) over {n} random subsets of {size} test faces."
        for n, size in subsets.itertuples(index=False)
    ]
    remarks.append(f"Paper: quoted from Kamyab and Azimifar. {NOTHING}: no number.")
    shown = table[table["metric"].isin([column.metric for column in columns])]
    notes = shown.assign(note=shown["note"].fillna("").str.split("; ")).explode("note")
    for note, rows in notes[notes["note"] != ""].groupby("note", sort=False):
        remarks.append(f"{', '.join(map(title, rows['method'].unique()))}: {note}.")
    return remarks
