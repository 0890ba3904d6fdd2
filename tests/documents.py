"""README and the pages of docs/, as tests read them."""

from __future__ import annotations

from places import committed

FOLDER = committed().resolve()
PAGES = [FOLDER / "README.md", *sorted((FOLDER / "docs").glob("*.md"))]


def text_of(name: str) -> str:
    """A page on one line, as a reader sees it."""
    return " ".join((FOLDER / name).read_text(encoding="utf-8").split())
