"""The page that leads to all pages of a folder of results."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from pathlib import Path
from urllib.parse import quote

from deepmds_keras.predict.page import fill_page

_ITEM = '<li><a href="{page}"><img src="{picture}" alt="" loading="lazy">{name}</a></li>'


def write_index(path: Path, results: Iterable[Sequence[str]]) -> None:
    """Write the page, complete or not at all; it shows the first picture of each source.

    Args:
        path: In the folder of the results.
        results: Names of the files of each source; those without a page are left out.

    Raises:
        InputError: The file cannot be written.
    """
    items = {}
    for files in results:
        pages, pictures = ([f for f in files if f.endswith(kind)] for kind in (".html", ".png"))
        for page in pages:
            items[page] = _ITEM.format(
                page=_link(page),
                picture=_link(pictures[0]),  # every page has one
                name=html.escape(page.removesuffix(".html")),
            )
    pages = "\n".join(items[page] for page in sorted(items))
    fill_page(path, "index.html", {"title": f"Faces of {len(items)} sources", "pages": pages})


def _link(name: str) -> str:
    return "./" + quote(name.encode("utf-8", "surrogateescape"))
