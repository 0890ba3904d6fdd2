"""The few marks that texts of a report may hold."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

_MARKS = re.compile(
    r"`(?P<code>[^`]+)`|\*\*(?P<strong>.+?)\*\*|\[(?P<link>[^]]+)\]\((?P<to>[^)]+)\)"
)


@dataclass(frozen=True)
class Span:
    """A piece of a text: `"text"`, `"code"`, `"strong"` or a `"link"` to an address."""

    kind: str
    text: str
    to: str = ""


def spans(text: str) -> Iterator[Span]:
    """A text in pieces, in order. Strong words may hold the other marks."""
    start = 0
    for mark in _MARKS.finditer(text):
        if mark.start() > start:
            yield Span("text", text[start : mark.start()])
        yield Span(mark.lastgroup if mark["link"] is None else "link", *_of(mark))
        start = mark.end()
    if start < len(text):
        yield Span("text", text[start:])


def _of(mark: re.Match) -> tuple[str, str]:
    return next(mark[name] for name in ("code", "strong", "link") if mark[name]), mark["to"] or ""
