"""The README's headline table is the committed results, and its commands exist."""

import re
from pathlib import Path

import pandas as pd
import pytest

from experiments.methods import METHODS

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
ROWS = {
    cells[0]: cells[1:]
    for cells in re.findall(r"^\| ([^|]+) \| ([^|]+) \| ([^|]+) \| ([^|]+) \|$", README, re.M)
}


@pytest.mark.parametrize(("model", "column"), [("ict", 1), ("openhead", 2)])
def test_headline_numbers_are_those_of_the_results(model, column):
    table = pd.read_csv(ROOT / "results" / model / "bfm" / "table.csv")
    mse = table[table["metric"] == "mse"].set_index("method")
    shown = [method for method in METHODS if method.title in ROWS]
    assert {"ours", "ours_stable", "mean_shape", "linear"} <= {method.id for method in shown}
    for method in shown:
        cells = ROWS[method.title]
        measured, quoted = mse.loc[method.id, ["mean", "paper_mean"]] * 1e4
        assert cells[column] == f"{measured:.2g}", method.id
        assert cells[0] == ("–" if pd.isna(quoted) else f"{quoted:g}"), method.id


def test_every_target_of_the_readme_is_one_of_the_makefile():
    targets = {*re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.M)}
    assert {*re.findall(r"(?:`|^)make ([a-z-]+)", README, re.M)} <= targets


def test_every_link_of_the_readme_leads_somewhere():
    for link in re.findall(r"\]\((?!https?:)([^)]+)\)", README):
        assert (ROOT / link).exists(), link
