"""The audit and the ablation in the report, and when the audit is out of date."""

import shutil

import pandas as pd
import pytest

from deepmds_keras.io.checksums import sha256_of
from experiments.audit.checks import CHECKS
from experiments.audit.claim_tables import table_of
from experiments.audit.claims import load_claims
from experiments.audit.findings import does_not_hold, holds, holds_if
from experiments.manifest import write_manifest
from experiments.presets import SMOKE
from experiments.records import write_text
from experiments.report.report import main
from experiments.report.staleness import stale
from experiments.run import Run
from experiments.scoring.tables import write_csv
from experiments.studies.ablation import HEADS

TABLE = "smoke/openhead/ablation/table.csv"
STAGE = {
    "model_sha256": "0" * 64, "build": "bfm-smoke-paper-seed0", "stage": "faces",
    "command": "python -m experiments faces",
    "started": "2026-01-02T03:04:05+00:00", "seconds": 75.0, "peak_memory_mb": 300,
}  # fmt: skip


@pytest.fixture
def results(tmp_path):
    """An ablation, and an audit that read it."""
    run = Run("openhead", SMOKE, results=tmp_path)
    folder = run.experiment_results("ablation")
    metrics = ("loss_train", "loss_inference", "mse")
    rows = [("no_autoencoder", 4800, m, 2e-4, 2e-4, 1e-5, 1e-4, 3e-4, 5) for m in metrics]
    heads = ["variant", "faces", "metric", "median", "mean", "std", "min", "max", "count"]
    write_csv(folder / "table.csv", pd.DataFrame(rows, columns=heads))
    write_manifest(run, "ablation", [STAGE], folder)
    findings = dict.fromkeys(CHECKS, does_not_hold("1 > 2."))
    findings |= {"symmetric": holds("0 < 1."), "occlusion": holds_if("if <few>", "3 | 4.")}
    folder = run.experiment_results("audit")
    write_csv(folder / "claims.csv", table_of(load_claims(), findings, "openhead"))
    digest = sha256_of([tmp_path / TABLE])
    audit = STAGE | {"stage": "audit", "tables": {"ablation/table.csv": digest}}
    write_manifest(run, "audit", [STAGE, audit], folder)
    return tmp_path


def written(results):
    main(["--preset", "smoke", "--results", str(results)])
    folder = results / "smoke" / "openhead" / "report"
    return (folder / "report.md").read_text(), (folder / "index.html").read_text()


def test_verdicts_and_evidence_are_in_both_reports(results):
    text, page = written(results)
    counts = f"1 holds, 1 holds with a condition, {len(CHECKS) - 2} do not hold"
    assert counts in text and counts in page
    assert text.index("Which claims of the paper hold") < text.index("What the parts are good for")
    assert r"holds if \<few\>" in text and "holds if &lt;few&gt;" in page
    assert "0 \\< 1." in text and r"3 \| 4." in text
    assert "dissimilarity.symmetric(asymmetry, largest_output, n_faces)" in page


def test_ablation_is_a_table_of_its_variants(results):
    text, _ = written(results)
    assert all(head in text for head in HEADS.values())
    assert (
        "| Without the autoencoder | 4,800 | 5 | 2.00 ± 0.10 | 2.00 ± 0.10 | 2.00 ± 0.10 |" in text
    )


def test_an_audit_of_tables_that_changed_is_stale(results):
    folder = results / "smoke" / "openhead"
    assert stale(folder) == []
    write_text(results / TABLE, (results / TABLE).read_text() + "\n")
    problems = [line for line in stale(folder) if "/audit: " in line]
    assert len(problems) == 1
    assert "ablation/table.csv changed since it was read; run: rm" in problems[0]
    assert "&& make audit" in problems[0]
    shutil.rmtree(folder / "ablation")
    assert any("/audit: ablation/table.csv changed" in line for line in stale(folder))
