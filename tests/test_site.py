"""The site has every page of docs/; `make site` itself fails on a broken link."""

import yaml
from places import ROOT

_CONFIG = yaml.load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"), yaml.BaseLoader)
# Made from the docstrings, and from files beside docs/.
_NOT_IN_DOCS = ["api.md", "index.md", "licences.md"]


def pages_of(nav):
    for entry in nav:
        for target in entry.values():
            yield from pages_of(target) if isinstance(target, list) else [target]


def test_every_page_is_in_the_navigation_once():
    pages = [*(ROOT / "docs").glob("*.md")]
    assert sorted(pages_of(_CONFIG["nav"])) == sorted([*_NOT_IN_DOCS, *(p.name for p in pages)])


def test_the_site_is_built_strictly():
    assert _CONFIG["strict"] == "true"
    assert _CONFIG["validation"]["anchors"] == "warn"
