"""Transfer: one training for all methods, and tests that differ by the noise alone."""

import numpy as np
import pandas as pd
import pytest
import runs
from places import SHARED

from data_gen.models.registry import load_model
from data_gen.views.photo_views import sample_photo_views
from experiments.lifting import transfer
from experiments.lifting.transfer import NOISES_MM, principal_components, training_faces
from experiments.manifest import files_of, read_manifest
from experiments.presets import TINY
from experiments.run import Run
from experiments.streams import Stream

pytestmark = pytest.mark.slow

METHODS = ["mean_shape", "linear", "aldrian", "ours_stable", "lifting"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("transfer")
    runs.succeed("transfer", folder, "--jobs", "1")
    return folder


@pytest.fixture(scope="module")
def table(folder):
    return pd.read_csv(runs.results(folder, "lifting/transfer") / "table.csv")


def test_every_method_is_tested_at_every_noise(table):
    rows = [*table[["trained", "tested", "noise_mm", "method"]].itertuples(index=False, name=None)]
    assert rows == [("openhead", "openhead", noise, m) for noise in NOISES_MM for m in METHODS]
    assert (table["n_faces"] == TINY.test_faces).all()


def test_tests_differ_by_the_noise_alone(table):
    errors = table.pivot(index="noise_mm", columns="method", values="mse")
    assert errors["mean_shape"].nunique() == 1, "the faces are the same"
    assert errors["lifting"].is_monotonic_increasing
    assert errors.loc[0, "lifting"] < errors.loc[0, "linear"] < errors.loc[0, "mean_shape"]


def test_a_model_that_is_not_there_is_left_out_with_the_reason(folder):
    results = runs.results(folder, "lifting/transfer")
    text = (results / "table.tex").read_text(encoding="utf-8")
    assert "Not tested on ICT faces, which DATA= does not hold" in text
    made = read_manifest(results)
    assert made["files"] == files_of(results) and "figures/transfer.png" in made["files"]
    assert made["stages"][0]["left_out"] == ["ict"]


def test_networks_are_kept(folder, table):
    work = runs.work(folder, "bfm")
    written = {path: path.stat().st_mtime_ns for path in (work / "transfer").iterdir()}
    assert len(written) == 3
    (work / "transfer.json").unlink()
    runs.succeed("transfer", folder, "--jobs", "1")
    assert {path: path.stat().st_mtime_ns for path in written} == written
    again = pd.read_csv(runs.results(folder, "lifting/transfer") / "table.csv")
    pd.testing.assert_frame_equal(again, table)


@pytest.mark.skipif(not (SHARED / "ict-facekit").exists(), reason="no ICT-FaceKit here")
def test_both_open_models_are_tested_whichever_is_trained_on():
    for name in ("openhead", "ict"):
        models, left_out = transfer.tested_models(Run(name, TINY, data=str(SHARED)))
        assert ([*models][0], {*models}, left_out) == (name, {"openhead", "ict"}, [])
        assert {len(own.landmarks["ibug51"]) for own in models.values()} == {51}


def test_errors_in_training_have_the_strength_that_is_told():
    run = Run("openhead", TINY)
    model = load_model("openhead", scheme="ibug51")
    views, shapes, sd = training_faces(run, model)
    rng = np.random.default_rng([run.seed, Stream.TRANSFER_TRAINING])
    rng.random(len(sd))
    exact, same, _ = sample_photo_views(model, "ibug51", len(sd), rng, detector_sd=0)
    assert np.array_equal(shapes, same)
    assert ((views - exact) / sd[:, None, None]).std() == pytest.approx(1, abs=0.02)
    assert (sd < 1).mean() > 0.3 and sd.max() > 4


def test_components_are_those_of_the_shapes():
    rng = np.random.default_rng(0)
    mean, known = rng.normal(size=(6, 3)), rng.normal(size=(2, 6, 3)) * 10
    coefficients = rng.standard_normal((500, 2))
    shapes = mean + np.tensordot(coefficients, known, 1)
    found_mean, basis = principal_components(shapes)
    flat, own = (shapes - shapes.mean(0)).reshape(500, -1), basis.reshape(len(basis), -1)
    assert np.allclose(found_mean, shapes.mean(0)) and len(basis) == 2
    assert np.allclose(own.T @ own, flat.T @ flat / 500)
