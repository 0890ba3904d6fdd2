"""Markdown, as GitHub shows it, and pages of HTML, by templates."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape

# `code`, **strong** words, links and marks of notes; or a character that would mean something.
_MARKS = re.compile(r"`[^`]+`|\*\*|\]\([^)]+\)|<sup>[\d, ]+</sup>|([\\`*_{}<>|#~]|&(?=#?\w+;))")


@dataclass(frozen=True)
class Table:
    """Rows of texts, the first of each the row's name.

    Attributes:
        caption: Stands above it.
        rows: The cells, by the columns' heads.
        words: Heads of the columns that hold words; numbers stand on the right.
        notes: Counted from 1, as `Notes` marks them in the cells.
    """

    caption: str
    rows: pd.DataFrame
    words: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def rules(self) -> list[str]:
        """Alignment of each column."""
        words = {self.rows.columns[0], *self.words}
        return [":--" if head in words else "--:" for head in self.rows]


class Notes(list):
    """Notes of a table, each written once."""

    def mark(self, notes: list[str]) -> str:
        """Return the numbers of notes, to be put behind the text of a cell."""
        self += [note for note in dict.fromkeys(notes) if note not in self]
        numbers = sorted({self.index(note) + 1 for note in notes})
        return f"<sup>{', '.join(map(str, numbers))}</sup>" if numbers else ""


def escaped(text: object) -> str:
    """Return a text that shows as it is, but for what `_MARKS` lets it hold."""
    return _MARKS.sub(lambda mark: f"\\{mark[1]}" if mark[1] else mark[0], str(text))


def row(cells: Iterable[object]) -> str:
    """Return a row of a table. A bar would end a cell, even in code."""
    texts = (re.sub(r"(?<!\\)\|", r"\|", escaped(text)) for text in cells)
    return f"| {' | '.join(texts)} |"


_ENVIRONMENT = Environment(
    loader=FileSystemLoader(Path(__file__).parents[1]),
    autoescape=select_autoescape(("html.j2",)),
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_ENVIRONMENT.filters |= {"md": escaped, "row": row}


def render(template: str, **values: object) -> str:
    """Return the text that a template makes of values.

    Args:
        template: File below `experiments/`. One of HTML escapes what it is given.
        values: By their names in the template.
    """
    return _ENVIRONMENT.get_template(template).render(values)


def markdown(template: str, **values: object) -> str:
    """Return the same with one blank line between blocks."""
    return re.sub(r"\n{3,}", "\n\n", render(template, **values)).strip() + "\n"
