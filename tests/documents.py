"""README, the pages of docs/ and the tables of results, as tests read them."""

from __future__ import annotations

import pandas as pd
from places import committed

FOLDER = committed().resolve()
PAGES = [FOLDER / "README.md", *sorted((FOLDER / "docs").glob("*.md"))]


def text_of(name: str) -> str:
    """A page on one line, as a reader sees it."""
    return " ".join((FOLDER / name).read_text(encoding="utf-8").split())


def table_of(page: str, head: str) -> dict[str, list[str]]:
    """Cells of a page's table whose head begins so, by the first of each row."""
    text = (FOLDER / page).read_text(encoding="utf-8")
    lines = text[text.index(f"\n| {head} |") + 1 :].split("\n\n")[0].splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]
    return {row[0]: row[1:] for row in rows}


def results(name: str) -> pd.DataFrame:
    """A CSV file of `results/`."""
    return pd.read_csv(FOLDER / "results" / name)


def errors_of(folder: str) -> pd.DataFrame:
    """Rows of a table of results with mean squared errors, by method."""
    table = results(f"{folder}/table.csv")
    return table[table["metric"] == "mse"].set_index("method")
