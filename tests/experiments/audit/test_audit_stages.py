"""Ablation and audit from the command line, on the files of a run that is done."""

import json
import shutil

import pandas as pd
import pytest
import runs

from experiments.audit.checks import CHECKS, NOT_KEPT, TOPICS
from experiments.studies.ablation import METRICS
from experiments.studies.variants import TITLES
from experiments.verdicts import UNKNOWN

pytestmark = pytest.mark.slow

WITHOUT_EVIDENCE = {
    *("celeba-aldrian", "celeba-mobileface", "celeba-zhao"),  # make reproduce-celeba
    *("casia-comparable", "pose-51"),  # make reproduce-flame
    "mediapipe-poses",  # make pretrained
    "first-use",  # a search of the literature
}


def run(stage, folder):
    return runs.run(stage, folder, "--preset", "smoke")


@pytest.fixture(scope="module")
def audited(smoke_bfm, tmp_path_factory):
    """A copy of the smallest run, with its ablation and audit."""
    folder = shutil.copytree(smoke_bfm.folder, tmp_path_factory.mktemp("audit") / "whole")
    for stage in ("ablation", "audit"):
        done = run(stage, folder)
        assert done.returncode == 0, done.stderr
    return folder


def results(folder, name):
    return runs.results(folder, name, "smoke")


def claims(folder):
    return pd.read_csv(results(folder, "audit") / "claims.csv", keep_default_na=False)


def test_ablation_has_every_variant_and_criterion(audited):
    table = pd.read_csv(results(audited, "ablation") / "table.csv")
    assert {*table["variant"]} == TITLES.keys()
    assert {*table["metric"]} == {*METRICS}
    # Of so few faces none may be frontal.
    assert ((table["mean"] > 0) | (table["metric"] == "mse_frontal")).all()
    mse = table[table["metric"] == "mse"].set_index("variant")["mean"]
    assert mse.nunique() == len(mse), "every variant changes what is learnt"
    for name in (
        "table.tex",
        "losses.csv",
        "figures/mini_batches.png",
        "figures/training_faces.pdf",
    ):
        assert (results(audited, "ablation") / name).stat().st_size > 500


def test_audit_has_a_verdict_on_every_claim(audited):
    table = claims(audited)
    assert {*table["id"]} == CHECKS.keys()
    assert {*table.loc[table["evidence"] == "", "id"]} == WITHOUT_EVIDENCE
    assert {*table.loc[table["verdict"] == UNKNOWN, "condition"]} >= {"`make seeds`"}
    own = table.set_index("id")
    # What no size of the experiment changes.
    assert own.loc["symmetric", "verdict"] == own.loc["parameters-zhao", "verdict"] == "holds"
    assert own.loc["p-value", "verdict"] == own.loc["distance-rank", "verdict"] == "does not hold"
    folder = results(audited, "audit")
    figures = {"poses", "perturbations", "spectra", "timings", "bias"}
    assert figures <= {path.stem for path in (folder / "figures").glob("*.png")}
    together = audited / "results" / "smoke" / "audit"
    assert {path.name for path in together.iterdir()} == {"claims.csv", "claims.md", "claims.tex"}


def test_manifest_says_what_was_read(audited):
    manifest = json.loads((results(audited, "audit") / "manifest.json").read_text())
    (record,) = (stage for stage in manifest["stages"] if stage["stage"] == "audit")
    assert {"bfm/metrics.csv", "ablation/metrics.csv"} <= record["tables"].keys()


def test_what_takes_long_is_measured_once(audited):
    kept = {path.stem: path for path in audited.rglob("build/**/audit/*.json")}
    assert kept.keys() == TOPICS.keys() - {*NOT_KEPT}
    before = {name: path.stat().st_mtime_ns for name, path in kept.items()}
    first = claims(audited)
    assert run("audit", audited).returncode == 0
    assert {name: path.stat().st_mtime_ns for name, path in kept.items()} == before
    again = claims(audited)
    timed = again["id"].isin(["inference-time"])  # how long it takes differs
    pd.testing.assert_frame_equal(first[~timed], again[~timed])


def test_a_second_ablation_only_prints_its_table(audited):
    folder = results(audited, "ablation")
    before = (folder / "manifest.json").stat().st_mtime_ns
    done = run("ablation", audited)
    assert done.returncode == 0
    assert "Without the autoencoder" in done.stdout
    assert "ablation:" not in done.stdout, "no stage was run"
    assert (folder / "manifest.json").stat().st_mtime_ns == before
