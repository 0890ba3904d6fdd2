"""Check every claim of the paper on one face model, and put all face models side by side."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import pandas as pd
from threadpoolctl import threadpool_limits

from deepmds_keras.io.checksums import sha256_of
from experiments.arguments import parse_run
from experiments.audit.checks import CHECKS, NOT_KEPT, TOPICS, topic_of
from experiments.audit.claim_tables import combine, table_of
from experiments.audit.claims import judge, load_claims
from experiments.audit.evidence import Inputs, measured_file
from experiments.face_models import TITLES
from experiments.figures import audit_curves as figures
from experiments.figures.style import save
from experiments.manifest import clear_results, records_of, write_manifest
from experiments.progress import Bar
from experiments.records import write_json
from experiments.running import stage
from experiments.scoring.tables import write_csv
from experiments.verdicts import counted, phrase

POSES = ("yaw", "pitch", "roll", "field_of_view")
PERTURBATIONS = ("noise_percent", "missing_percent")
# Of the views of the paper, section "Datasets"; see `data_gen.views.projections.sample_cameras`.
TRAINED = {"yaw": (-45, 45), "pitch": (-30, 0), "roll": (0, 0), "field_of_view": (0, 5)}


def measured(inputs: Inputs, topic: str) -> dict:
    """Measure a topic; where it takes long, keep the result until its arrays or its code change."""
    module = TOPICS[topic]
    if topic in NOT_KEPT:
        return module.measure(inputs)
    path = measured_file(inputs.run, topic)
    made_from = {**inputs.key, "code": sha256_of([Path(module.__file__)])}
    kept = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    if kept.get("made_from") != made_from:
        with threadpool_limits(1):  # sums in one order on any machine
            kept = {"made_from": made_from, "measured": module.measure(inputs)}
        write_json(path, kept)
    return json.loads(path.read_text(encoding="utf-8"))["measured"]


def check(inputs: Inputs) -> tuple[pd.DataFrame, dict[str, dict]]:
    """Every claim's verdict, as `tables.table_of`, and what was measured, by topic."""
    claims, numbers = load_claims(), {}
    with Bar(TOPICS, desc="audit", unit="topic") as bar:
        for topic in bar:
            bar.set_postfix_str(topic)
            numbers[topic] = measured(inputs, topic)
    findings = {
        claim: judge(claims[claim], function, numbers[topic_of(function)])
        for claim, function in CHECKS.items()
    }
    return table_of(claims, findings, inputs.run.model), numbers


def curves_of(numbers: Mapping[str, Mapping]) -> pd.DataFrame:
    """All curves that were measured: `sweep, value, method, mse, sem`."""
    rows = [row for measured in numbers.values() for row in measured.get("curves", ())]
    return pd.DataFrame(rows, columns=["sweep", "value", "method", "mse", "sem"])


def draw(numbers: Mapping[str, Mapping], curves: pd.DataFrame, folder: Path) -> None:
    """Write every figure."""
    save(figures.error_curves(curves, POSES, TRAINED), folder, "poses")
    save(figures.error_curves(curves, PERTURBATIONS, {}), folder, "perturbations")
    save(figures.spectra(numbers["dissimilarity"]["spectra"]), folder, "spectra")
    save(figures.timings(pd.DataFrame(numbers["complexity"]["timings"])), folder, "timings")
    save(figures.bias(numbers["bias"]["bias"]), folder, "bias")


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    inputs = Inputs(run)
    folder = inputs.run.experiment_results("audit")
    with stage(inputs.run, "audit") as record:
        table, numbers = check(inputs)
        record["tables"] = inputs.tables
        clear_results(folder)
        curves = curves_of(numbers)
        write_csv(folder / "claims.csv", table)
        write_csv(folder / "curves.csv", curves)
        draw(numbers, curves, folder / "figures")
    write_manifest(run, "audit", records_of(inputs.run, "audit"), folder)
    together = combine(run.model_results.parent, TITLES)
    print(f"\n{run.model}, {run.preset.name} preset, seed {run.seed}: {counted(table)}\n")
    for row in table.itertuples():
        print(f"{row.claim}\n    {phrase(row.verdict, row.condition)}")
    print(f"\nClaims, figures and manifest: {folder}/\nAll face models: {together}/")
