"""A metric that is registered, and nothing else, is in every table."""

import dataclasses
import re

import numpy as np
import pandas as pd
import pytest

from deepmds_keras import normalise
from experiments.inputs import Faces
from experiments.manifest import write_manifest
from experiments.metrics import METRICS, Metric
from experiments.presets import SMOKE
from experiments.report.experiment import load_experiments
from experiments.report.sections import report as markdown_report
from experiments.run import Run
from experiments.scoring.numbers import plus_minus
from experiments.scoring.scores import evaluate, score
from experiments.scoring.typesetting import text
from experiments.tracks.results import write_results

N, L = 24, 72
COSTS = {"ours": {"ms_per_face": 2.5, "n_parameters": 27323}}
STAGE = {
    "model_sha256": "0" * 64, "stage": "faces", "command": "python -m experiments faces",
    "started": "2026-01-02T03:04:05+00:00", "seconds": 75.0, "peak_memory_mb": 300,
}  # fmt: skip


@pytest.fixture
def faces():
    shapes = normalise(np.random.default_rng(0).random((N, L, 3)))
    return Faces(shapes[..., :2], np.float32(shapes), np.full(N, 200.0), shapes, None)


def predictions(faces):
    """Of two methods, one of which does not find every face."""
    noise = np.random.default_rng(1).standard_normal(faces.shapes.shape)
    found = {"linear": faces.shapes + 0.01 * noise, "ours": faces.shapes + 0.02 * noise}
    found["linear"][::5] = np.nan
    return found


def read_table(folder):
    return pd.read_csv(folder / "table.csv", dtype={"n_subsets": "Int64", "subset_size": "Int64"})


def run_of(tmp_path, track="bfm"):
    return Run("openhead", SMOKE, track, build=tmp_path / "build", results=tmp_path / "results")


def test_a_registered_metric_is_in_every_table(faces, tmp_path, monkeypatch):
    metric = Metric(
        id="largest_mm",
        head="Largest (mm)",
        legend="largest error of a landmark of the {n}",
        better="lower",
        per_face=lambda scores: scores.distances_mm.max(1),
        decimals=1,
    )
    monkeypatch.setitem(METRICS, metric.id, metric)
    run, shapes = run_of(tmp_path), predictions(faces)
    folder = run.experiment_results("bfm")
    metrics, scores = evaluate(run, faces, shapes, COSTS)
    write_results(run, folder, metrics, scores, {})
    write_manifest(run, "reproduce-bfm", [STAGE | {"build": run.work.name}], folder)

    values = pd.read_csv(folder / "metrics.csv").query("metric == @metric.id")
    assert len(values) == len(shapes) * SMOKE.n_subsets
    largest = 200 * np.linalg.norm(scores["ours"].aligned - faces.shapes, axis=2).max(1)
    ours = values[values["method"] == "ours"]["value"]
    assert largest.min() < ours.min() < ours.max() < largest.max()

    table = read_table(folder)
    mean = table.set_index(["method", "metric"]).loc[("ours", metric.id), "mean"]
    assert mean == pytest.approx(ours.mean())
    report = markdown_report("openhead", load_experiments(run.model_results), {})
    shown = {
        (folder / "table.tex").read_text(): f" {mean:.1f}",
        text(table, "bfm"): f" {mean:.1f}",
        report: f"| {plus_minus(mean, ours.std())}",
    }
    for output, cell in shown.items():
        assert "Largest (mm)" in output and "largest error of a landmark of" in output
        row = r"(?m)^(\| )?Deep-MDS(?!,).*" + re.escape(cell)
        assert re.search(row, output)


def test_a_table_made_before_a_metric_was_registered_is_printed(faces, tmp_path, monkeypatch):
    run = run_of(tmp_path)
    folder = run.experiment_results("bfm")
    write_results(run, folder, *evaluate(run, faces, predictions(faces), COSTS), {})
    before = text(read_table(folder), "bfm")
    monkeypatch.setitem(METRICS, "new", dataclasses.replace(METRICS["rmse_mm"], id="new"))
    assert text(read_table(folder), "bfm") == before


def test_faces_that_a_method_did_not_find_are_left_out_and_counted(faces, tmp_path):
    run = run_of(tmp_path, "flame")
    metrics, scores = evaluate(run, faces, predictions(faces), {})
    values = metrics.set_index(["method", "metric"])["value"]
    assert values.notna().all()
    assert (values["ours", "detection_rate"] == 1).all()
    assert values["linear", "detection_rate"].mean() == pytest.approx(1 - 5 / N, abs=0.15)
    assert np.isnan(scores["linear"].mse[::5]).all()
    other = dataclasses.replace(run, track="bfm")
    metrics, _ = evaluate(other, faces, predictions(faces), {})
    assert "detection_rate" not in {*metrics["metric"]}


def test_scores_of_some_faces_are_those_of_all(faces):
    scores, some = score(predictions(faces)["linear"], faces), [3, 5, 7]
    assert np.array_equal(scores[some].mse, scores.mse[some], equal_nan=True)
    assert np.array_equal(scores[some].depth_corr, scores.depth_corr[some], equal_nan=True)
