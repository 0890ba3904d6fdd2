"""The site has every page of docs/, and its tour runs; `make site` fails on a broken link."""

import json
import re
import runpy

import pytest
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
    docs = ROOT / "docs"
    pages = [path.name for path in (*docs.glob("*.md"), *docs.glob("*.ipynb"))]
    assert sorted(pages_of(_CONFIG["nav"])) == sorted([*_NOT_IN_DOCS, *pages])


def test_the_site_is_built_strictly():
    assert _CONFIG["strict"] == "true"
    assert _CONFIG["validation"]["anchors"] == "warn"


def cells_of_script(text):
    """Cells of a percent script: kind, source."""
    for cell in re.split(r"^# %%", text, flags=re.M)[1:]:
        kind, _, source = cell.partition("\n")
        if kind.strip() == "[markdown]":
            yield "markdown", re.sub(r"^# ?", "", source, flags=re.M).strip()
        else:
            yield "code", source.strip()


def test_the_notebook_has_the_cells_of_its_script_and_their_outputs():
    path = ROOT / "docs" / "tour.ipynb"
    notebook = json.loads(path.read_text(encoding="utf-8"))["cells"]
    script = (ROOT / "docs" / "tour.py").read_text(encoding="utf-8")
    assert [*cells_of_script(script)] == [
        (cell["cell_type"], "".join(cell["source"])) for cell in notebook
    ]
    outputs = [output for cell in notebook for output in cell.get("outputs", ())]
    assert {output["output_type"] for output in outputs} == {"stream", "display_data"}
    assert {output.get("name", "stdout") for output in outputs} == {"stdout"}, "nothing went wrong"
    assert path.stat().st_size < 300_000


@pytest.mark.slow
def test_the_tour_embeds_true_distances_exactly_and_prints_what_it_measured(capsys, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.delenv("DISPLAY", raising=False)
    tour = runpy.run_path(str(ROOT / "docs" / "tour.py"))
    deep_mds, true_distances, mean_shape = tour["errors"].values()
    assert true_distances < 1e-9
    assert 0 < mean_shape < deep_mds < 50 * mean_shape < 5e-3, "as the tour says"
    printed = re.findall(r"([\d.]+) × 10⁻⁴", capsys.readouterr().out)
    assert [float(number) for number in printed] == pytest.approx(
        [1e4 * error for error in tour["errors"].values()], abs=1e-4
    )
