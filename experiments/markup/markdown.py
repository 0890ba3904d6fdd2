"""A report as Markdown, as GitHub shows it."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path

from experiments.markup.blocks import (
    Block,
    Cell,
    Faces,
    Fold,
    Heading,
    Listing,
    Paragraph,
    Picture,
    Table,
)
from experiments.markup.inline import spans

_SPECIAL = re.compile(r"([\\`*_{}<>|#~])")


def markdown(blocks: Iterable[Block], folder: Path) -> str:
    """The text of a file in `folder`; pictures are named relative to it."""
    return "\n\n".join(_block(block, folder) for block in blocks) + "\n"


def _block(block: Block, folder: Path) -> str:
    match block:
        case Heading(level, text, anchor):
            return f'<a id="{anchor}"></a>\n\n{"#" * level} {_inline(text)}'
        case Paragraph(text):
            return _inline(text)
        case Listing(items):
            return "\n".join(f"- {_inline(item)}" for item in items)
        case Table():
            return _table(block)
        case Picture(path, caption):
            address = os.path.relpath(path, folder).replace(os.sep, "/")
            return f"![{_inline(caption)}]({address})\n\n{_inline(caption)}"
        case Faces(_, _, examples):
            count = len(examples["faces"])
            return f"{count} faces can be turned about in `index.html`, which `make report` writes."
        case Fold(title, inner):
            body = markdown(inner, folder)
            return f"<details><summary>{_inline(title)}</summary>\n\n{body}\n</details>"
    raise TypeError(f"block must be one of those of blocks.py. Received {type(block).__name__}.")


def _table(table: Table) -> str:
    heads = [_inline(column.title) for column in table.columns]
    rules = ["--:" if column.numeric else ":--" for column in table.columns]
    lines = [heads, rules, *([_cell(cell) for cell in row] for row in table.rows)]
    rows = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    notes = "\n".join(f"{k}. {_inline(note)}" for k, note in enumerate(table.notes, 1))
    return "\n\n".join(part for part in (_inline(table.caption), rows, notes) if part)


def _cell(cell: Cell) -> str:
    marks = f"<sup>{', '.join(map(str, cell.notes))}</sup>" if cell.notes else ""
    return f"{_inline(cell.text)}{marks}"


def _inline(text: str) -> str:
    pieces = []
    for span in spans(text):
        if span.kind == "code":
            pieces.append(f"`{span.text.replace('|', '&#124;')}`")
        elif span.kind == "strong":
            pieces.append(f"**{_inline(span.text)}**")
        elif span.kind == "link":
            pieces.append(f"[{_inline(span.text)}]({span.to})")
        else:
            pieces.append(_SPECIAL.sub(r"\\\1", span.text))
    return "".join(pieces)
