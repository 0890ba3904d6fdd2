"""A report as one HTML page that holds all it shows and loads nothing."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from html import escape
from itertools import groupby
from pathlib import Path

from deepmds_keras.predict.page import json_in_html, wireframe_script
from experiments.markup.blocks import (
    Block,
    Cell,
    Column,
    Faces,
    Fold,
    Heading,
    Listing,
    Paragraph,
    Picture,
    Table,
)
from experiments.markup.inline import spans
from experiments.report.pictures import data_uri

_FOLDER = Path(__file__).parent
_PHONE = 800  # pixels of a figure that is wider than a phone's screen can show sharply


def page(blocks: Sequence[Block]) -> str:
    """The page, whose title is its first heading; links to results are relative to its folder."""
    headings = [block for block in blocks if isinstance(block, Heading)]
    contents = "".join(
        f'<li><a href="#{escape(block.anchor)}">{_inline(block.text)}</a></li>'
        for block in headings
        if block.level == 2
    )
    body = _blocks(blocks[1:])
    values = {
        "title": escape(headings[0].text),
        "style": (_FOLDER / "page.css").read_text(encoding="utf-8"),
        "contents": contents,
        "body": body,
        "wireframe": wireframe_script(),
        "script": (_FOLDER / "page.js").read_text(encoding="utf-8"),
    }
    template = (_FOLDER / "page.html").read_text(encoding="utf-8")
    # In one go, so that a text that looks like a field stays a text.
    return re.sub(r"\{\{(\w+)\}\}", lambda field: values[field[1]], template)


def _blocks(blocks: Iterable[Block]) -> str:
    return "\n".join(map(_block, blocks))


def _block(block: Block) -> str:
    match block:
        case Heading(level, text, anchor):
            return f'<h{level} id="{escape(anchor)}">{_inline(text)}</h{level}>'
        case Paragraph(text):
            return f"<p>{_inline(text)}</p>"
        case Listing(items):
            return f"<ul>{''.join(f'<li>{_inline(item)}</li>' for item in items)}</ul>"
        case Table():
            return _table(block)
        case Picture(path, caption):
            address, (width, height) = data_uri(path)
            wide = ' class="wide"' if width > _PHONE else ""
            return (
                f'<figure><img src="{address}" width="{width}" height="{height}" '
                f'alt="{escape(caption)}"{wide}>'
                f"<figcaption>{_inline(caption)}</figcaption></figure>"
            )
        case Faces(anchor, title, examples, methods):
            data = json_in_html(examples | {"methods": methods, "title": title})
            return (
                f'<div class="faces" id="{escape(anchor)}">'
                f'<script type="application/json">{data}</script></div>'
            )
        case Fold(title, inner):
            return f"<details><summary>{_inline(title)}</summary>\n{_blocks(inner)}\n</details>"
    raise TypeError(f"block must be one of those of blocks.py. Received {type(block).__name__}.")


def _table(table: Table) -> str:
    rows = "\n".join(f"<tr>{_row(row, table.columns)}</tr>" for row in table.rows)
    notes = "".join(f"<li>{_inline(note)}</li>" for note in table.notes)
    caption = _inline(table.caption)
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(table.caption)}">'
        f'<table class="sortable"><caption>{caption}</caption>\n<thead>{_head(table.columns)}'
        f"</thead>\n<tbody>\n{rows}\n</tbody></table></div>"
        + (f'<ol class="notes">{notes}</ol>' if notes else "")
    )


def _head(columns: Sequence[Column]) -> str:
    """One row of headings, or two where columns have groups."""
    if not any(column.group for column in columns):
        return f"<tr>{''.join(_sorter(column) for column in columns)}</tr>"
    top, bottom = [], []
    for group, members in groupby(columns, key=lambda column: column.group):
        members = [*members]
        if group:
            top.append(f'<th scope="colgroup" colspan="{len(members)}">{_inline(group)}</th>')
            bottom += [_sorter(column) for column in members]
        else:
            top += [_sorter(column, ' rowspan="2"') for column in members]
    return f"<tr>{''.join(top)}</tr><tr>{''.join(bottom)}</tr>"


def _sorter(column: Column, span: str = "") -> str:
    kind = ' class="number"' if column.numeric else ""
    label = escape(f"{column.title}: sort")
    return (
        f'<th scope="col" aria-sort="none"{kind}{span}>'
        f'<button type="button" aria-label="{label}">{_inline(column.head)}</button></th>'
    )


def _row(row: Sequence[Cell], columns: Sequence[Column]) -> str:
    first, *rest = row
    cells = [f'<th scope="row">{_content(first)}</th>']
    for cell, column in zip(rest, columns[1:], strict=True):
        kind = ' class="number"' if column.numeric else ""
        value = "" if math.isnan(cell.value) else f' data-value="{float(cell.value)!r}"'
        cells.append(f"<td{kind}{value}>{_content(cell)}</td>")
    return "".join(cells)


def _content(cell: Cell) -> str:
    marks = f"<sup>{', '.join(map(str, cell.notes))}</sup>" if cell.notes else ""
    patch = f'<i class="patch" style="background:{escape(cell.colour)}"></i>' if cell.colour else ""
    return f"{patch}{_inline(cell.text)}{marks}"


def _inline(text: str) -> str:
    pieces = []
    for span in spans(text):
        if span.kind == "code":
            pieces.append(f"<code>{escape(span.text)}</code>")
        elif span.kind == "strong":
            pieces.append(f"<strong>{_inline(span.text)}</strong>")
        elif span.kind == "link":
            pieces.append(f'<a href="{escape(span.to)}">{_inline(span.text)}</a>')
        else:
            pieces.append(escape(span.text))
    return "".join(pieces)
