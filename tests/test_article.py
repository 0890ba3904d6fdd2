"""The article says what the results say, and refers to what is there."""

import re
import shutil
import subprocess

import pandas as pd
import pytest
from jinja2 import Environment
from places import ROOT, committed

from docs.latex import booktabs, in_latex
from docs.make_docs import Results, grid, pages

FOLDER = committed().resolve()
TEMPLATE = "docs/templates/docs/article/article.tex.j2"
ARTICLE = (FOLDER / "docs" / "article" / "article.tex").read_text(encoding="utf-8")

_EXPRESSION = re.compile(r"<<.*?>>|<%.*?%>|<#.*?#>", re.S)
_LENGTH = re.compile(r"[\d.]+(?:\\textwidth|ex|em|pt)\b")
_VERSION = "Apache 2.0"
_VERDICT = re.compile("supported|refuted|undecided|not testable here")


def test_no_number_with_a_decimal_point_is_typed():
    _, text = (ROOT / TEMPLATE).read_text(encoding="utf-8").split(r"\begin{document}")
    text = _LENGTH.sub("", _EXPRESSION.sub("", text)).replace(_VERSION, "")
    assert not re.findall(r".*\d\.\d.*", text)


def test_figures_are_committed():
    figures = re.findall(r"\\includegraphics\[.*?\]\{(.*?)\}", ARTICLE)
    assert figures
    for figure in figures:
        places = [FOLDER / "results" / figure, FOLDER / "docs" / "pictures" / figure]
        assert any(place.exists() for place in places), figure


def test_references_are_those_of_the_bibliography():
    bibliography = (FOLDER / "docs" / "article" / "references.bib").read_text(encoding="utf-8")
    cited = re.findall(r"\\citep(?:\[.*?\])*\{(.*?)\}", ARTICLE)
    keys = {key.strip() for group in cited for key in group.split(",")}
    assert keys == {*re.findall(r"^@\w+\{(\w+),", bibliography, re.M)}


def test_every_table_figure_and_section_that_has_a_label_is_referred_to():
    labels = re.findall(r"\\label\{(.*?)\}", ARTICLE)
    assert len(labels) == len({*labels})
    assert {*labels} == {*re.findall(r"\\ref\{(.*?)\}", ARTICLE)}


def test_the_table_of_claims_has_each_once_with_its_verdicts():
    claims = pd.read_csv(FOLDER / "results" / "audit" / "claims.csv")
    table = ARTICLE.split(r"\label{tab:claims}")[1].split(r"\end{table}")[0]
    _, *rows = (row.split(" & ") for row in table.split("\n") if row.count(" & ") == 2)
    assert len(rows) == claims["id"].nunique()
    for protocol, cells in zip(
        ("authors", "faithful"), list(zip(*rows, strict=True))[1:], strict=True
    ):
        found = claims[claims["protocol"] == protocol].groupby("id")["verdict"].unique()
        shown = [_VERDICT.findall(cell) for cell in cells]
        assert sorted(map(sorted, shown)) == sorted(map(sorted, found))


def test_scales_and_the_known_model_fill_their_sections(tmp_path):
    results = tmp_path / "results"
    shutil.copytree(FOLDER / "results", results)
    path = results / "bfm68" / "scales" / "table.csv"
    table = pd.read_csv(path)
    table.loc[table["method"] == "deep_mds", "over_mean_shape"] = [2.61, 2.2, 2, 1.49]
    table.to_csv(path, index=False)
    for model in ("openhead", "ict"):
        path = results / model / "lifting" / "hard" / "table.csv"
        table = pd.read_csv(path)
        known = table[table["method"] == "model_fit"].assign(method="map")
        pd.concat([table, known]).to_csv(path, index=False)
    article = pages(Results(results))["docs/article/article.tex"]
    assert "error of Deep-MDS is 1.5 to 2.6 times that of the mean shape" in article
    assert "\nMAP fit" in article
    assert "not in these" not in article


def test_tables_are_escaped_and_heads_with_a_common_part_are_grouped():
    table = grid([["", "a & b", "of x: one", "of x: two"], ["5 %", "10⁻⁴", "–", "1"]])
    text = booktabs(table)
    assert r"\begin{tabular}{@{}lrrr@{}}" in text
    assert r"\multicolumn{2}{c}{of x}" in text
    assert r" & a \& b & one & two \\" in text
    assert r"5 \% & 10$^{-4}$ & -- & 1 \\" in text
    assert r"{@{}lp{3cm}rr@{}}" in booktabs(table, "lp{3cm}rr")


@pytest.mark.parametrize("text", [r"{{ x }}", r"\frac{1}{2} % 3", r"{%", r"{#1}"])
def test_braces_of_latex_are_left_alone(text):
    assert in_latex(Environment()).from_string(text).render() == text
    assert in_latex(Environment()).from_string("<< 1 + 1 >>").render() == "2"


def test_without_latex_the_packages_are_named(tmp_path):
    (tmp_path / "bash").symlink_to(shutil.which("bash"))
    words = [shutil.which("make"), "article"]
    done = subprocess.run(
        words, cwd=ROOT, env={"PATH": str(tmp_path)}, capture_output=True, text=True
    )
    assert done.returncode == 2
    (packages,) = re.findall(r"latexmk must be installed.*apt install (.*)\.", done.stderr)
    commands = (FOLDER / "docs" / "commands.md").read_text(encoding="utf-8")
    assert all(f"`{package}`" in commands for package in packages.split())
