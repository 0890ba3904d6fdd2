r"""Tables as LaTeX to `\input`: pandas' Styler writes them, for the package booktabs."""

import re
from collections.abc import Sequence

import pandas as pd

from experiments.scoring.numbers import scientific

_CHARACTERS = {c: rf"\{c}" for c in "&%$#_{}"} | {
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "\\": r"\textbackslash{}",
    "<": r"\textless{}", ">": r"\textgreater{}",
    "±": r"$\pm$", "×": r"$\times$", "−": "$-$", "–": "--",
}  # fmt: skip
_SUPERSCRIPTS = "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"
_AS_DIGITS = str.maketrans(_SUPERSCRIPTS, "-0123456789")


def tabular(cells: pd.DataFrame, columns: str, notes: Sequence[str] = ()) -> str:
    r"""A `tabular` in small type, with booktabs' rules.

    Args:
        cells: Texts. If the columns have two levels, the upper one heads groups.
        columns: Types of the columns, as `tabular` takes them.
        notes: Paragraphs below the table.
    """
    styler = cells.style.format(tex).format_index(tex, axis=1).hide(axis=0)
    body = styler.to_latex(
        column_format=f"@{{}}{columns}@{{}}", hrules=True, multicol_align="c"
    ).rstrip()
    if cells.columns.nlevels > 1:  # Styler has no rules below the heads of groups
        body = body.replace("\\\\\n", f"\\\\\n{_rules(cells.columns)}\n", 1)
    # As rows of the table they would stretch its last column to the width of the page.
    below = "".join(f"\n\\par\\noindent\\parbox{{\\linewidth}}{{{tex(note)}}}" for note in notes)
    return f"{{\\footnotesize\\setlength{{\\tabcolsep}}{{3pt}}%\n{body}{below}}}\n"


def plain_tabular(table: pd.DataFrame) -> str:
    r"""A plain table of names and numbers, with five digits each, to `\input`.

    The names of its columns become the heads; NaN and empty cells stay empty.
    """
    numeric = {*table.select_dtypes("number")}
    cells = table.map(_plain).rename(columns=lambda name: name.replace("_", " "))
    return tabular(cells, "".join("r" if name in numeric else "l" for name in table))


def _plain(value: object) -> str:
    if pd.isna(value):
        return ""
    return scientific(value, 5) if isinstance(value, float) else str(value)


def tex(string: str) -> str:
    """Text with LaTeX's special characters escaped, and ±, × and powers as mathematics."""
    powers = re.split(rf"\^(-?\d+)|([{_SUPERSCRIPTS}]+)", string)
    plain, raised = powers[::3], zip(powers[1::3], powers[2::3], strict=True)
    escaped = ["".join(_CHARACTERS.get(c, c) for c in part) for part in plain]
    exponents = [f"$^{{{a or b.translate(_AS_DIGITS)}}}$" for a, b in raised]
    return "".join(part for pair in zip(escaped, [*exponents, ""], strict=True) for part in pair)


def _rules(columns: pd.MultiIndex) -> str:
    """A rule below each head of a group."""
    places = pd.Series(range(1, len(columns) + 1)).groupby(columns.get_level_values(0), sort=False)
    groups = places.agg(["min", "max"]).drop("", errors="ignore")
    return "".join(
        rf"\cmidrule(lr){{{first}-{last}}}" for first, last in groups.itertuples(index=False)
    )
