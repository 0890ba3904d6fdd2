"""`make bench` at its smallest size: every part, a manifest that fits, and our own training."""

import json

import numpy as np
import pandas as pd
import pytest
import runs

from experiments.bench.measurements import COLUMNS
from experiments.manifest import files_of

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    runs.succeed("bench", folder)
    return folder / "results" / "tiny" / "bench"


@pytest.fixture(scope="module")
def table(folder):
    return pd.read_csv(folder / "bench.csv", keep_default_na=False, na_values=[""])


def test_every_part_is_timed_beside_the_released_way(table):
    assert tuple(table.columns) == COLUMNS
    parts = table[table["comparison"] == "parts"]
    ways = parts.groupby("part")["way"].agg(set)
    assert set(ways.index) == {
        "data generation", "pair features", "prediction", "embedding", "end to end",
    }  # fmt: skip
    assert all("released" in own and len(own) > 1 for own in ways)
    assert {"sklearn", "batched"} < ways["embedding"]
    assert {"sklearn", "batched", "lifting"} < ways["end to end"]
    assert {"faces", "landmarks", "training"} <= set(table["comparison"])
    assert table[table["part"] == "training step, MobileFace"]["way"].tolist() == ["ours"]


def test_lifting_is_timed_beside_deep_mds(table):
    for comparison, part in (("parts", "end to end"), ("one face", "one face at a time")):
        own = table[(table["comparison"] == comparison) & (table["part"] == part)].set_index("way")
        for solver in ("sklearn", "batched"):
            ratio = own.loc[solver, "ms_per_face"] / own.loc["lifting", "ms_per_face"]
            assert own.loc["lifting", f"times_{solver}"] == pytest.approx(ratio, rel=1e-6)
            assert ratio > 1


def test_an_empty_cell_has_its_reason(table):
    empty = table[table[["seconds", "peak_memory_mb"]].isna().any(axis=1)]
    assert (empty["note"].fillna("") != "").all()
    assert (table["seconds"].dropna() > 0).all()


def test_ratios_follow_from_the_times(table):
    np.testing.assert_allclose(
        table["ms_per_face"], 1000 * table["seconds"] / table["n_faces"], rtol=1e-6
    )
    parts = table[table["comparison"] == "parts"]
    for baseline in ("released", "sklearn", "batched"):
        for _, own in parts.groupby("part"):
            other = own.loc[own["way"] == baseline, "ms_per_face"]
            if len(other):
                expected = other.iloc[0] / own["ms_per_face"]
                np.testing.assert_allclose(own[f"times_{baseline}"], expected, rtol=1e-6)
            else:
                assert own[f"times_{baseline}"].isna().all()


def test_what_is_timed_as_our_training_is_our_training(table):
    steps = table[(table["comparison"] == "training") & (table["way"] == "ours")].set_index("part")
    of_the_method = ["training step, autoencoder", "training step, dissimilarity net"]
    assert steps.loc[of_the_method, "note"].str.contains("weights as ours to the last bit").all()


def test_solvers_agree_on_the_shipped_weights(folder):
    agreement = pd.read_csv(folder / "agreement.csv")
    assert agreement["experiment"].tolist() == ["shipped weights"], "nothing was trained here"
    assert (agreement["largest_stress_difference"] < 1e-4).all()
    assert (agreement["largest_shape_difference"] < 1e-3).all()


def test_manifest_fits_the_files(folder):
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["files"] == files_of(folder)
    names = {"bench.csv", "bench.tex", "agreement.csv", "figures/bench.png", "figures/bench.pdf"}
    assert names == set(manifest["files"])
    assert manifest["command"].startswith("make bench ")
    assert len(manifest["model_sha256"]) == 64
