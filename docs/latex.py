"""The pages' templates and tables in LaTeX, for the article."""

import pandas as pd
from jinja2 import Environment

from experiments.scoring.latex import tabular, tex


class Grid(str):
    """A table in Markdown.

    Attributes:
        rows: Its cells, the first row its head.
    """

    rows: list[list[str]]


def in_latex(pages: Environment) -> Environment:
    """The environment of the pages with `<< … >>` and `<% … %>`: LaTeX has its own braces."""
    article = pages.overlay(
        block_start_string="<%", block_end_string="%>",
        variable_start_string="<<", variable_end_string=">>",
        comment_start_string="<#", comment_end_string="#>",
    )  # fmt: skip
    article.filters |= {"tex": tex, "booktabs": booktabs}
    return article


def booktabs(table: Grid, columns: str | None = None) -> str:
    """A table of the pages in LaTeX.

    Args:
        table: Heads such as `"open head: exact"` are put below their common part.
        columns: Types of the columns, as `tabular` takes them; by default all but the first are
            numbers.
    """
    head, *rows = table.rows
    parts = [name.rpartition(": ")[::2] for name in head]
    grouped = any(group for group, _ in parts)
    heads = pd.MultiIndex.from_tuples(parts) if grouped else head
    cells = pd.DataFrame(rows, columns=heads)
    return tabular(cells, columns or "l" + "r" * (len(head) - 1)).rstrip()
