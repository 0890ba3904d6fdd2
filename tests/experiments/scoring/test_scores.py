"""Scores of every face and subset; a metric that is registered, and nothing else, is in all."""

import dataclasses
import re

import numpy as np
import pandas as pd
import pytest

from deepmds_keras import normalise
from deepmds_keras.errors import InputError
from deepmds_keras.files import write_arrays
from experiments.inputs import Faces
from experiments.presets import SMOKE
from experiments.records import write_record
from experiments.report.report import cells, markdown_table
from experiments.run import Run
from experiments.scoring.metrics import METRICS, Metric
from experiments.scoring.numbers import plus_minus
from experiments.scoring.scores import (
    evaluate,
    landmark_errors,
    load_predictions,
    metrics_by_seed,
    per_face,
    score,
    subsets,
)  # fmt: skip
from experiments.scoring.tables import write_tables
from experiments.scoring.typesetting import text

N, L = 24, 72
COSTS = {"deep_mds": {"ms_per_face": 2.5, "n_parameters": 27323}}


@pytest.fixture
def faces():
    shapes = normalise(np.random.default_rng(0).random((N, L, 3)))
    return Faces(shapes[..., :2], np.float32(shapes), np.full(N, 200.0), shapes, None)


@pytest.fixture
def predictions(faces):
    """Of two methods, one of which does not find every face."""
    noise = np.random.default_rng(1).standard_normal(faces.shapes.shape)
    shapes = {"ridge": faces.shapes + 0.01 * noise, "deep_mds": faces.shapes + 0.02 * noise}
    shapes["ridge"][::5] = np.nan
    return shapes


@pytest.fixture
def run(tmp_path):
    return Run("openhead", SMOKE, "bfm", build=tmp_path / "build", results=tmp_path / "results")


def table_of(run, metrics, scores):
    folder = run.experiment_results("bfm")
    options = {"experiment": "bfm", "subset_size": 9, "n_landmarks": L, "notes": {}}
    write_tables(folder, metrics, per_face=per_face(scores), **options)
    return pd.read_csv(folder / "table.csv")


def test_a_registered_metric_is_in_every_table(run, faces, predictions, monkeypatch):
    metric = Metric(
        id="largest_mm",
        head="Largest (mm)",
        legend="largest error of a landmark of the {n}",
        better="lower",
        per_face=lambda scores: scores.distances_mm.max(1),
        decimals=1,
    )
    monkeypatch.setitem(METRICS, metric.id, metric)
    metrics, scores = evaluate(run, faces, predictions, COSTS)
    of_metric = metrics[metrics["metric"] == metric.id]
    assert len(of_metric) == len(predictions) * SMOKE.n_subsets
    largest = 200 * np.linalg.norm(scores["deep_mds"].aligned - faces.shapes, axis=2).max(1)
    ours = of_metric[of_metric["method"] == "deep_mds"]["value"]
    assert largest.min() < ours.min() < ours.max() < largest.max()

    table = table_of(run, metrics, scores)
    mean = table.set_index(["method", "metric"]).loc[("deep_mds", metric.id), "mean"]
    assert mean == pytest.approx(ours.mean())
    latex = (run.experiment_results("bfm") / "table.tex").read_text()
    for output in (latex, text(table, "bfm"), markdown_table(cells(table, "bfm", "terminal"))):
        assert "Largest (mm)" in output
        assert re.search(rf"(?m)^(\| )?Deep-MDS .* {re.escape(f'{mean:.1f}')}\b", output)
        assert plus_minus(mean, ours.std()) not in output
    assert "largest error of a landmark of the 72, lower is better" in latex

    monkeypatch.delitem(METRICS, metric.id)
    before = text(table_of(run, *evaluate(run, faces, predictions, COSTS)), "bfm")
    monkeypatch.setitem(METRICS, metric.id, metric)
    assert text(pd.read_csv(run.experiment_results("bfm") / "table.csv"), "bfm") == before


def test_faces_that_a_method_did_not_find_are_left_out_and_counted(run, faces, predictions):
    flame = dataclasses.replace(run, track="flame")
    metrics, scores = evaluate(flame, faces, predictions, COSTS)
    values = metrics.set_index(["method", "metric"])["value"]
    assert values.notna().all()
    assert (values["deep_mds", "detection_rate"] == 1).all()
    assert values["ridge", "detection_rate"].mean() == pytest.approx(1 - 5 / N, abs=0.15)
    assert np.isnan(scores["ridge"].mse[::5]).all()
    assert values["deep_mds", "n_parameters"] == 27323
    assert "detection_rate" not in {*evaluate(run, faces, predictions, {})[0]["metric"]}
    assert {len(v) for of in per_face(scores).values() for v in of.values()} == {N - 5}
    subjects = np.repeat(["a", "b", "c", "d"], N // 4)
    of_subjects = per_face(scores, subjects)["mse"]["deep_mds"]
    expected = pd.Series(per_face(scores)["mse"]["deep_mds"])
    of_found = subjects[np.arange(N) % 5 > 0]
    np.testing.assert_allclose(of_subjects, [expected[of_found == s].mean() for s in "abcd"])
    off = 200 * (scores["ridge"].aligned - faces.shapes)[np.arange(N) % 5 > 0]
    expected = np.sqrt((off**2).sum(2).mean(0))
    np.testing.assert_allclose(landmark_errors(scores)["ridge"], expected)
    assert all(len({*chosen}) == SMOKE.subset_size for chosen in subsets(run, N)), "none twice"


def test_scores_of_some_faces_are_those_of_all(faces, predictions):
    scores, some = score(predictions["ridge"], faces), [3, 5, 7]
    assert np.array_equal(scores[some].mse, scores.mse[some], equal_nan=True)
    assert np.array_equal(scores[some].depth_corr, scores.depth_corr[some], equal_nan=True)


def test_a_similarity_of_the_truth_has_no_error(faces):
    """Procrustes' alignment takes away scale, place, direction and reflection."""
    turned, _ = np.linalg.qr(np.random.default_rng(2).standard_normal((3, 3)))
    scores = score(3 * faces.shapes @ turned * [1, 1, -1] + 5, faces)
    assert scores.mse.max() < 1e-12
    assert scores.depth_corr == pytest.approx(L)


def test_only_the_named_predictions_are_read(run, predictions):
    for method in (*predictions, "zhao"):
        shapes = predictions.get(method, np.zeros((1, L, 3)))
        write_arrays(run.prediction_file(method), {"shapes": shapes}, {"n_parameters": 7})
    loaded = load_predictions(run, ["deep_mds", "ridge"])
    assert [*loaded] == ["deep_mds", "ridge"] and loaded["deep_mds"][1] == {"n_parameters": 7}
    write_record(run.record_file("times"), {"times": {"deep_mds": {"ms_per_face": 2.5}}})
    arrays, description = load_predictions(run, ["deep_mds"])["deep_mds"]
    assert description == {"n_parameters": 7, "ms_per_face": 2.5}
    assert np.array_equal(arrays["shapes"], predictions["deep_mds"])
    with pytest.raises(InputError, match="mean_shape"):
        load_predictions(run, ["mean_shape"])


def test_seeds_are_those_that_the_run_asks_for(run):
    for seed in range(3):
        rows = [("deep_mds", "mse", 1e-4 * seed)]
        write_record(dataclasses.replace(run, seed=seed).record_file("seed"), {"rows": rows})
    for n in (2, 3):
        table = metrics_by_seed(dataclasses.replace(run, seeds=n))
        assert table["seed"].tolist() == [*range(n)]
        assert table["value"].tolist() == [1e-4 * seed for seed in range(n)]
    with pytest.raises(InputError, match=r"seed3.*seed\.json not found"):
        metrics_by_seed(dataclasses.replace(run, seeds=4))
