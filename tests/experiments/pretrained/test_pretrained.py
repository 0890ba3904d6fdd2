"""The stages that train, measure and ship weights, at the smallest size."""

import pandas as pd
import pytest
import runs
from places import MEDIAPIPE

from experiments.manifest import files_of, read_manifest
from experiments.presets import TINY
from experiments.records import read_record

pytestmark = pytest.mark.slow
STAGES = ("portraits", "photo-networks", "pretrained")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pretrained")
    for stage in STAGES:
        runs.succeed(stage, folder, "--jobs", "1")
    return folder


def test_every_scheme_is_tested_on_exact_landmarks_and_on_those_found(folder):
    table = pd.read_csv(runs.results(folder, "pretrained") / "table.csv")
    exact = table[table["views"] == "exact"]
    assert {*exact["scheme"]} == {"ibug51", "ibug68", "bfm72"}
    assert (exact["n_faces"] == TINY.test_portraits).all() and not exact["not_found"].any()
    found = read_record(runs.work(folder, "bfm") / "portraits.json")["found"]["openhead-tests"]
    assert "dlib" in found and ("mediapipe" in found) == MEDIAPIPE
    # What was found in the place of a face is left out, and a line of one face, too.
    assert {*table["views"]} <= {"exact", *(name for name, n in found.items() if n > 1)}
    assert ("mediapipe_corrected" in {*table["method"]}) == MEDIAPIPE
    mean = table[table["method"] == "mean_shape"]["found_again"]
    assert (mean.abs() < 1e-9).all(), "of the mean shape nothing is found again"


def test_models_that_are_not_there_are_named(folder):
    record = read_record(runs.work(folder, "bfm") / "portraits.json")
    assert record["left_out"] == ["ict"]
    made = read_manifest(runs.results(folder, "pretrained"))
    assert made["files"] == files_of(runs.results(folder, "pretrained"))


def test_photos_and_networks_are_kept(folder):
    work = runs.work(folder, "bfm")
    kept = [*(work / "portraits").iterdir(), *(work / "photo-networks").glob("*.npz")]
    written = {path: path.stat().st_mtime_ns for path in kept}
    for stage in STAGES[:2]:
        runs.succeed(stage, folder, "--jobs", "1")
    assert {path: path.stat().st_mtime_ns for path in kept} == written
