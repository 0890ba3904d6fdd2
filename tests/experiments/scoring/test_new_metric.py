"""A metric that is registered, and nothing else, is in every table."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from deepmds_keras import normalise
from experiments.inputs import Faces
from experiments.metrics import METRICS, Metric
from experiments.presets import SMOKE
from experiments.report.experiment import Experiment
from experiments.report.report_tables import other_criteria_table
from experiments.run import Run
from experiments.scoring.scores import evaluate, score
from experiments.scoring.typesetting import text
from experiments.tracks.results import write_results

N, L = 24, 72


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


def run_of(tmp_path, track="bfm"):
    return Run("openhead", SMOKE, track, build=tmp_path / "build", results=tmp_path / "results")


def test_a_registered_metric_is_in_every_table(faces, tmp_path, monkeypatch):
    metric = Metric(
        id="largest_mm",
        head="Largest (mm)",
        legend="largest error of a face's {n} landmarks",
        better="lower",
        per_face=lambda scores: scores.distances_mm.max(1),
        decimals=1,
    )
    monkeypatch.setitem(METRICS, metric.id, metric)

    run, shapes = run_of(tmp_path), predictions(faces)
    folder = run.experiment_results("bfm")
    metrics, scores = evaluate(run, faces, shapes, {"ours": {"ms_per_face": 2.5}})
    write_results(run, folder, metrics, scores, {})

    distances = np.linalg.norm(scores["ours"].aligned - faces.shapes, axis=2) * 200
    rows = pd.read_csv(folder / "metrics.csv").query("metric == 'largest_mm'")
    assert rows.groupby("method")["subset"].count().to_dict() == dict.fromkeys(
        shapes, SMOKE.n_subsets
    )
    ours = rows[rows["method"] == "ours"]["value"]
    assert distances.max(1).min() < ours.min() < ours.max() < distances.max()

    table = pd.read_csv(folder / "table.csv", dtype={"n_subsets": "Int64", "subset_size": "Int64"})
    mean = table.set_index(["method", "metric"]).loc[("ours", "largest_mm"), "mean"]
    assert mean == pytest.approx(ours.mean())
    cell = f"{mean:.1f}"
    for shown, row in (
        ((folder / "table.tex").read_text(), "Deep-MDS & "),
        (text(table, "bfm"), "Deep-MDS "),
    ):
        assert "Largest (mm)" in shown and "largest error of a face's 72 landmarks" in shown
        assert any(row in line and cell in line for line in shown.splitlines())
    report = other_criteria_table(Experiment(folder, {"files": ["table.csv"]}))
    rows = report.rows.set_index("Method")
    assert rows.loc["Deep-MDS", "Largest (mm)"].startswith(cell[:-1])


def test_faces_that_a_method_did_not_find_are_left_out_and_counted(faces, tmp_path):
    run = run_of(tmp_path, "flame")
    metrics, scores = evaluate(run, faces, predictions(faces), {})
    values = metrics.set_index(["method", "metric"])["value"]
    assert values.notna().all()
    assert (values["ours", "found_fraction"] == 1).all()
    assert values["linear", "found_fraction"].mean() == pytest.approx(1 - 5 / N, abs=0.15)
    assert np.isnan(scores["linear"].mse[::5]).all()
    other = dataclasses.replace(run, track="bfm")
    metrics, _ = evaluate(other, faces, predictions(faces), {})
    assert "found_fraction" not in {*metrics["metric"]}


def test_scores_of_some_faces_are_those_of_all(faces):
    scores, some = score(predictions(faces)["linear"], faces), [3, 5, 7]
    assert np.array_equal(scores[some].mse, scores.mse[some], equal_nan=True)
    assert np.array_equal(scores[some].depth_corr, scores.depth_corr[some], equal_nan=True)
