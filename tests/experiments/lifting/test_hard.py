"""Tables of hard views, predicted standard deviations, and the stage that makes them."""

import numpy as np
import pandas as pd
import pytest
import runs

from experiments.lifting import hard
from experiments.lifting.calibration import NOMINAL, coverage
from experiments.lifting.hard_networks import trainings
from experiments.lifting.hard_tables import by_cell, by_yaw, cells, latex, remarks, summarise
from experiments.lifting.views import CONDITIONS
from experiments.presets import PAPER
from experiments.run import Run

HARD = CONDITIONS[2]


def made_up():
    """Errors of 40 faces: about twice those of the limit, in one condition from two seeds."""
    rng, found = np.random.default_rng(0), {}
    for condition in CONDITIONS:
        best = 1e-5 * rng.uniform(1, 2, 40)
        if not condition.missing:
            found["ours_stable", condition, 0] = 1e-3 * np.ones(40)
        for seed in (0, 1) if condition is HARD else (0,):
            found["lifting", condition, seed] = (2 + 0.1 * seed) * best
        found["limit", condition, 0] = best
    return found


def test_normal_errors_are_covered_as_they_should():
    rng = np.random.default_rng(0)
    sd = rng.uniform(0.5, 2, (300, 70, 3))
    errors = sd * rng.standard_normal(sd.shape)
    np.testing.assert_allclose(coverage(errors, sd).mean(0), NOMINAL, atol=0.01)
    assert (coverage(2 * errors, sd).mean(0) < NOMINAL - 0.02).all()


def test_a_constant_ratio_to_the_limit_has_no_error():
    rows = by_cell(made_up(), {}).set_index(["method", "condition", "seed", "metric"])
    ratio = rows.loc["lifting", HARD.id, 1, "times_limit"]
    assert ratio["mean"] == pytest.approx(2.1)
    assert ratio["standard_error"] == pytest.approx(0, abs=1e-12)
    own = made_up()["lifting", HARD, 0]
    mse = rows.loc["lifting", HARD.id, 0, "mse"]
    assert mse["mean"] == pytest.approx(own.mean())
    assert mse["standard_error"] == pytest.approx(own.std(ddof=1) / 40**0.5)


def test_tables_have_a_mean_over_seeds_and_a_reason_for_what_is_empty():
    table = summarise(by_cell(made_up(), {}))
    rows = table[table["metric"] == "mse"].set_index(["method", "condition"])
    assert len(rows) == 3 * len(CONDITIONS)
    seeded = rows.loc["lifting", HARD.id]
    assert seeded["n_seeds"] == 2
    assert seeded["std"] / seeded["mean"] == pytest.approx(0.1 / 2**0.5 / 2.05)
    empty = rows[rows["mean"].isna()]
    assert {*empty.index} == {("ours_stable", c.id) for c in CONDITIONS if c.missing}
    assert empty["note"].str.contains("no way to leave a landmark out").all()
    shown = cells(table, "mse").set_index("Method")
    assert shown.loc["Deep-MDS, cosine schedule"].tolist() == 4 * ["1,000"] + 3 * ["–"]
    assert "mean over 2 seeds" in " ".join(remarks(table))
    assert latex(table).count(r"\\") > 4


def test_curves_by_yaw_hold_every_hard_face_once():
    curves = by_yaw(made_up(), {c.id: np.linspace(-59, 59, 40) for c in CONDITIONS})
    assert (curves.groupby(["method", "condition"])["n_faces"].sum() == 40).all()
    assert {*curves["yaw"]} == {5, 15, 25, 35, 45, 55}
    assert {*curves["condition"]} == {c.id for c in CONDITIONS if c.protocol == "hard"}


def test_every_condition_has_its_network_and_one_has_three_seeds():
    found = trainings(Run("openhead", PAPER))
    assert len({training.id for training in found}) == len(found) == 1 + 4 + 5 + 2
    assert sum(t.method == "lifting" and t.condition.training == "hard_1" for t in found) == 3
    assert found[0].method == "lifting_large"


@pytest.mark.slow
def test_a_stage_that_was_killed_goes_on_and_a_second_run_does_nothing(tmp_path):
    whole, killed = (tmp_path / name for name in ("whole", "killed"))
    runs.succeed("hard", whole, "--jobs", "1")
    stage = runs.Stage("hard", killed, "--jobs", "1")
    networks = runs.work(killed, "bfm") / "hard" / "networks"
    while stage.wait(0.2) is None and len([*networks.glob("*.npz")]) < 2:
        pass
    stage.kill()
    stage.done()
    assert not runs.results(killed, hard.FOLDER).exists()
    kept = {path: path.stat().st_mtime_ns for path in networks.glob("*.npz")}
    runs.succeed("hard", killed, "--jobs", "1")
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in kept.items())
    first, second = (runs.results(folder, hard.FOLDER) for folder in (whole, killed))
    for name in ("metrics.csv", "table.csv", "by_yaw.csv", "calibration.csv", "table.tex"):
        assert (first / name).read_bytes() == (second / name).read_bytes(), name
    table = pd.read_csv(first / "table.csv")
    rows = table[(table["metric"] == "times_limit") & (table["method"] != "limit")]
    assert (rows["mean"] > 1).all()
    before = {path: path.stat().st_mtime_ns for path in runs.files_in(whole)}
    runs.succeed("hard", whole, "--jobs", "1")
    assert {path: path.stat().st_mtime_ns for path in runs.files_in(whole)} == before
