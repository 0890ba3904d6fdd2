"""README and the pages of docs/, as tests read them."""

from __future__ import annotations

from places import ROOT


def text_of(name):
    """A page on one line, as a reader sees it."""
    return " ".join((ROOT / name).read_text(encoding="utf-8").split())
