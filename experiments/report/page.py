"""A report as one HTML page that holds all it shows and loads nothing."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from html import escape
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token

from deepmds_keras.predict.page import json_in_html, wireframe_script
from experiments.markup.markdown import render
from experiments.report.pictures import data_uri

_PHONE = 800  # pixels of a figure that is wider than a phone's screen can show sharply
_ANCHOR = re.compile(r'<a id="([^"]+)"></a>')


def page(
    markdown: str,
    folder: Path,
    faces: Mapping[str, dict],
    colour_of: Callable[[str], str | None],
) -> str:
    """Return the page of a report.

    Args:
        markdown: The report. Its first heading is the page's title; a paragraph before a table is
            its caption, a list behind it are its notes.
        folder: Of the report, from which it names its pictures.
        faces: To be turned about, by the anchor of the heading under which they stand.
        colour_of: The colour of a cell's text, or None.
    """
    parser = MarkdownIt("commonmark", {"html": True}).enable("table")
    tokens = _arranged(parser.parse(markdown))
    for place, token in enumerate(tokens):
        if token.type in ("th_open", "td_open"):
            _dress_cell(*tokens[place - 1 : place + 3], colour_of)
        for child in token.children or ():
            if child.type == "image":
                _embed(child, folder)

    def shown(part: list[Token]) -> str:
        return parser.renderer.render(part, parser.options, {})

    headings = [k for k, token in enumerate(tokens) if token.type == "heading_open"]
    contents = {
        tokens[k].attrs["id"]: shown(tokens[k + 1 : k + 2])
        for k in headings
        if tokens[k].tag == "h2"
    }
    return render(
        "report/page.html.j2",
        title=tokens[headings[0] + 1].content,
        contents=contents,
        body=shown(tokens[headings[0] + 3 :]),
        faces=json_in_html(faces),
        wireframe=wireframe_script(),
    )


def _arranged(tokens: list[Token]) -> list[Token]:
    """Anchors become the names of their headings, and what stands around tables part of them."""
    arranged: list[Token] = []
    for token in tokens:
        before = arranged[-3:]
        if token.type == "heading_open" and (anchor := _ANCHOR.fullmatch(before[1].content)):
            del arranged[-3:]
            token.attrs["id"] = anchor[1]
        elif token.type == "table_open":
            del arranged[-3:]
            label = escape(before[1].content)
            before[0].tag = before[2].tag = "caption"
            box = f'<div class="scroll" tabindex="0" role="region" aria-label="{label}">'
            arranged += [_html(box), token, *before]
            continue
        elif token.type == "ordered_list_open":
            token.attrs["class"] = "notes"
        arranged.append(token)
        if token.type == "table_close":
            arranged.append(_html("</div>"))
    return arranged


def _dress_cell(
    before: Token,
    opening: Token,
    text: Token,
    closing: Token,
    colour_of: Callable[[str], str | None],
) -> None:
    """Rows begin with their names, numbers stand on the right, and some texts have a colour."""
    if opening.attrs.pop("style", "") == "text-align:right":
        opening.attrs["class"] = "number"
    if opening.tag == "th":
        opening.attrs["scope"] = "col"
        return
    if before.type == "tr_open":
        opening.tag = closing.tag = "th"
        opening.attrs["scope"] = "row"
    if [child.type for child in text.children] == ["code_inline"]:
        opening.attrs["class"] = "command"
    elif text.children and (colour := colour_of(text.children[0].content)):
        text.children.insert(0, _html(f'<i class="patch" style="background:{escape(colour)}"></i>'))


def _embed(image: Token, folder: Path) -> None:
    address, (width, height) = data_uri(folder / image.attrs["src"])
    image.attrs |= {"src": address, "width": width, "height": height}
    if width > _PHONE:
        image.attrs["class"] = "wide"


def _html(text: str) -> Token:
    return Token("html_inline", "", 0, content=text)
