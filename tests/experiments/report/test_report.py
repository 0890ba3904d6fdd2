"""The report: all results and what is missing, as they are on the disk, in valid Markdown."""

import dataclasses
import re

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt
from places import committed

from experiments.presets import SMOKE
from experiments.records import write_csv, write_json, write_text
from experiments.report import report as step
from experiments.report.report import RESULTS, load_results, markdown_table, readable, report
from experiments.run import Run
from experiments.scoring.tables import write_tables

PARSER = MarkdownIt("commonmark", {"html": True}).enable("table")
MODELS = [path.parent.name for path in sorted((committed() / "results").glob("*/bfm"))]
STEP = {
    "step": "datasets.faces", "preset": vars(SMOKE), "started": "2026-01-02T03:04:05+00:00",
    "seconds": 75.0, "peak_memory_mb": 3000, "commit": "0123456789ab", "python": "3.11.7",
    "platform": "Linux", "processor": "A", "packages": {"numpy": "2.4"},
    "photos": {"used": 4853, "no face found": 147}, "times": {"deep_mds": {"ms_per_face": 1.0}},
}  # fmt: skip


def write_result(folder, table=None, **entries):
    """A folder of results with a table, a figure and a manifest."""
    if table is not None:
        write_csv(folder / "table.csv", table)
    write_text(folder / "figures" / "errors.png", "")
    names = [p.relative_to(folder).as_posix() for p in sorted(folder.rglob("*")) if p.is_file()]
    manifest = {"command": "make it", "steps": [STEP | entries], "files": dict.fromkeys(names, "")}
    write_json(folder / "manifest.json", manifest)


@pytest.fixture
def run(tmp_path):
    """Two compared tables, claims on two face models, and another table."""
    run = Run("openhead", SMOKE, results=tmp_path)
    rows = [
        (method, metric, subset, value * factor)
        for method, value in (("deep_mds", 2e-4), ("mean_shape", 1e-4), ("ridge", 5e-5))
        for metric in ("mse", "depth_corr")
        for subset, factor in enumerate((0.75, 1.25))
    ]
    metrics = pd.DataFrame(rows, columns=["method", "metric", "subset", "value"])
    per_face = {"mse": {"deep_mds": np.arange(1.0, 20), "ridge": np.arange(19.0)}}
    of = {"experiment": "bfm", "subset_size": 10, "n_landmarks": 72}
    of["notes"] = {"mobileface": "<b> | left out"}
    for seed in (0, 1):
        folder = dataclasses.replace(run, seed=seed).experiment_results("bfm")
        write_tables(folder, metrics, per_face=per_face, **of)
        write_result(folder)
    claims = [
        ("openhead", "It is a % of 72.", "holds", "1 < 2"),
        ("ict", "It is unbiased.", "does not hold", ""),
    ]
    claims = pd.DataFrame(claims, columns=["model", "claim", "verdict", "evidence"]).assign(
        id="unseen"
    )
    write_csv(tmp_path / "smoke" / "audit" / "claims.csv", claims)
    write_result(run.experiment_results("audit"), processor="B")
    hard = pd.DataFrame(
        {"method": ["deep_mds", "no_noise"], "n_faces": 5000, "mse": [1.5e-5, np.nan]}
    )
    write_result(run.experiment_results("lifting/hard"), hard)
    return run


@pytest.fixture
def text(run):
    step.main(run)
    return (run.model_results / "report" / "report.md").read_text()


def section(text, heading):
    return text.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]


def row_of(text, name):
    return next(line for line in text.splitlines() if line.startswith(f"| {name} |"))


def test_the_papers_numbers_stand_beside_ours(text):
    bfm = section(text, "The paper's BFM table")
    assert "| 1.4 ± 0.005 | 2.0 ± 0.7 |" in row_of(bfm, "Deep-MDS")
    assert r"MobileFace: \<b\> \| left out" in bfm
    assert "`make it` at commit 0123456789ab" in bfm and "1 min 15 s" in bfm
    assert "../bfm/figures/errors.png" in bfm and "[table.tex](../bfm/table.tex)" in bfm
    assert "| used: 4,853; no face found: 147 |" in bfm
    glance = row_of(text, "[The paper's BFM table](#bfm)")
    assert glance.endswith("| 1.4 ± 0.005 | 2.0 ± 0.7 | – | 1.0 ± 0.4 | 0.50 ± 0.18 |")
    assert "\n## The paper's BFM table (seed1)\n" in text


def test_other_tables_are_shown_as_they_are(text):
    hard = section(text, "Hard views, against the lower bound")
    assert "| method | n faces | MSE |" in hard
    assert row_of(hard, "Deep-MDS") == "| Deep-MDS | 5,000 | 1.5 × 10⁻⁵ |"
    assert row_of(hard, "no noise") == "| no noise | 5,000 | – |"
    claims = section(text, "Claims of the paper")
    assert r"| It is a % of 72. | holds | 1 \< 2 |" in claims
    assert "unbiased" not in claims, "of the other face model"
    assert "| processor | A; B |" in text and "| name | smoke |" in text


def test_another_folder_of_results_is_one_row(run, monkeypatch):
    write_result(run.experiment_results("new"), pd.DataFrame({"mse": [1.0]}))
    assert "\n## new\n" in report(run, load_results(run.model_results))
    monkeypatch.setitem(RESULTS, "new", "A new experiment")
    assert "\n## A new experiment\n" in report(run, load_results(run.model_results))


def test_a_long_table_has_a_column_for_each_metric():
    rows = [
        (f"variant_{k}", metric, mean * (k + 1), spread)
        for k in range(21)
        for metric, mean, spread in (("mse", 2e-6, 1e-7), ("share", 0.5, 0.01))
        if (k, metric) != (20, "share")
    ]
    table = readable(pd.DataFrame(rows, columns=["variant", "metric", "mean", "std"]))
    assert [*table] == ["variant", "MSE (10⁻⁵)", "share"]
    assert table.iloc[1].tolist() == ["variant 1", "0.400 ± 0.010", "1.000 ± 0.010"]
    assert table["share"].iloc[20] == "–"


@given(st.text(r"\`*_{}<>|#~&;[]a1 ", min_size=1, max_size=12).map(str.strip))
def test_cells_show_as_they_are(cell):
    """markdown-it, which follows GitHub's rules, reads what we write."""
    if not cell or "**" in cell or cell.count("`") > 1:
        return  # strong words and code are markup
    tokens = PARSER.parse(markdown_table(pd.DataFrame({"a": ["x"], "b": [cell]})))
    children = [token for token in tokens if token.type == "inline"][3].children
    assert "".join(child.content for child in children) == cell


def test_numbers_stand_on_the_right_and_bars_in_code_end_no_cell():
    table = pd.DataFrame({"a": ["x"], "b": ["−1.5 ± 2"], "c": ["`a | b`"], "d": ["–"]})
    _, rules, row = markdown_table(table).splitlines()
    assert (rules, row) == ("| :-- | --: | :-- | --: |", r"| x | −1.5 ± 2 | `a \| b` | – |")


@pytest.mark.parametrize("model", MODELS)
def test_the_committed_report_is_that_of_the_committed_results(model):
    folder = committed() / "results" / model / "report"
    text = report(Run(model), load_results(folder.parent))
    assert (folder / "report.md").read_text(encoding="utf-8") == text
    assert [path.name for path in folder.iterdir()] == ["report.md"]
    for link in re.findall(r"\]\(([^)#]+)\)", text):
        assert (folder / link).exists(), link
