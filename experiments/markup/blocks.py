"""What a report is made of, before it is a page or a Markdown file.

Texts may hold `code`, **strong** words and [links](address), which both writers understand;
everything else in them is shown as it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Heading:
    """A heading of level 1 to 4; `anchor` is its name in links."""

    level: int
    text: str
    anchor: str


@dataclass(frozen=True)
class Paragraph:
    text: str


@dataclass(frozen=True)
class Listing:
    """A list without order."""

    items: tuple[str, ...]


@dataclass(frozen=True)
class Column:
    """Of a table; neighbours of one group share a heading. Numbers stand on the right."""

    head: str
    group: str = ""
    numeric: bool = True

    @property
    def title(self) -> str:
        return f"{self.group}: {self.head}" if self.group else self.head


@dataclass(frozen=True)
class Cell:
    """Text, the number by which a table is sorted (NaN: none), notes, and a CSS colour."""

    text: str
    value: float = math.nan
    notes: tuple[int, ...] = ()
    colour: str = ""


@dataclass(frozen=True)
class Table:
    """Rows of cells, the first of each the row's name; `notes` are counted from 1."""

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Picture:
    """A PNG file."""

    path: Path
    caption: str


@dataclass(frozen=True)
class Faces:
    """Faces that can be turned about: what `examples.write_examples` wrote, and method colours."""

    anchor: str
    title: str
    examples: dict
    methods: dict[str, dict[str, str]]


@dataclass(frozen=True)
class Fold:
    """Blocks that are shown when asked for."""

    title: str
    blocks: tuple[Block, ...]


Block = Heading | Paragraph | Listing | Table | Picture | Faces | Fold
