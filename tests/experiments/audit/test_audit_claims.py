"""Verdicts of conditions on numbers with intervals, also those of the committed tables."""

import math
import shutil

import numpy as np
import pandas as pd
import pytest
from places import committed

from deepmds_keras.errors import InputError
from experiments.audit import audit, claims
from experiments.audit.claims import conditions, decide, numbers_of
from experiments.audit.tables import Tables
from experiments.presets import FULL
from experiments.records import write_csv
from experiments.run import Run
from experiments.scoring.intervals import Estimate, point

RESULTS = committed() / "results"
MODELS = ("openhead", "ict")
OTHERS = ("*.json", "*.md", "*.pdf", "*.png", "*.tex")


@pytest.mark.parametrize(
    ("low", "high", "condition", "verdict"),
    [
        (0.8, 0.9, "a < 1", claims.SUPPORTED),
        (0.8, 1.1, "a < 1", claims.UNDECIDED),
        (1.1, 1.2, "a < 1", claims.REFUTED),
        (1.1, 1.2, "a > 1", claims.SUPPORTED),
        (0.9, 1.2, "a > 1", claims.UNDECIDED),
        (0.8, 1.0, "a > 1", claims.REFUTED),
        (2, 2, "a = 2", claims.SUPPORTED),
        (2, 3, "a = 2", claims.UNDECIDED),
        (1, 3, "a = 2", claims.UNDECIDED),
        (3, 4, "a = 2", claims.REFUTED),
        (np.float64(0.9), np.float64(1.2), "a < 1", claims.UNDECIDED),
        (math.nan, math.nan, "a < 1", claims.NOT_TESTABLE),
    ],
)
def test_the_whole_interval_is_to_meet_a_condition(low, high, condition, verdict):
    assert decide(condition, {"a": Estimate(1.0, low, high)}) == (verdict, "a")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a < 2; b < 2", (claims.SUPPORTED, "a")),
        ("a < 2; b < 1", (claims.REFUTED, "b")),
        ("a > 0; a < 0.5", (claims.REFUTED, "a")),
        ("a < 2; missing < 1", (claims.NOT_TESTABLE, "missing")),
        ("missing < 1; a < 0.5", (claims.REFUTED, "a")),
        ("open < 1; a < 2", (claims.UNDECIDED, "open")),
        ("open < 1; a < 0.5", (claims.REFUTED, "a")),
        ("open < 1; missing < 1", (claims.NOT_TESTABLE, "missing")),
    ],
)
def test_a_condition_that_is_missed_decides_whatever_else_is_not_known(text, expected):
    known = {"a": point(1), "b": point(1.5), "open": Estimate(1.0, 0.9, 1.1)}
    assert decide(text, known) == expected


@pytest.mark.parametrize("text", ["a", "a <", "a < b", "a <= 1", "a < 1, b < 2", ""])
def test_what_is_no_condition_is_refused(text):
    with pytest.raises(InputError, match="a < 1; b = 2"):
        conditions(text)


def test_claims_are_named_once_and_their_conditions_are_on_numbers():
    numbers = numbers_of(Tables(Run("ict", FULL, results=RESULTS)))
    names = [name for estimates in numbers.values() for name in estimates]
    assert len({*names}) == len(names)
    table = pd.read_csv(audit.CLAIMS)
    assert [*table["id"]] == [*numbers]
    for row in table.itertuples():
        texts = (row.supported_if, row.supported_if_authors)
        named = {name for text in texts if isinstance(text, str) for name, *_ in conditions(text)}
        assert named <= numbers[row.id].keys()


@pytest.fixture
def copied(tmp_path):
    """Runs whose results are a copy of the committed tables."""
    for model in MODELS:
        shutil.copytree(RESULTS / model, tmp_path / model, ignore=shutil.ignore_patterns(*OTHERS))
    return [Run(model, FULL, results=tmp_path) for model in MODELS]


def judged(run, protocol="faithful"):
    """Verdicts by claim."""
    numbers = audit.numbers_table(run, run.experiment_results("audit"))
    claims = audit.judge(numbers, run.model).set_index("id")
    return claims[claims["protocol"] == protocol]


def test_committed_verdicts_are_those_of_the_committed_tables(copied):
    names = ("claims.csv", "numbers.csv")
    committed = {(m, n): pd.read_csv(RESULTS / m / "audit" / n) for m in MODELS for n in names}
    for run in copied:
        where = run.experiment_results("audit")
        numbers = audit.numbers_table(run, where)
        write_csv(where / "numbers.csv", numbers)
        write_csv(where / "claims.csv", audit.judge(numbers, run.model))
        for name in names:
            pd.testing.assert_frame_equal(pd.read_csv(where / name), committed[run.model, name])
    folder = audit.combine(copied[0].results)
    assert {path.name for path in folder.iterdir()} == {"claims.csv", "claims.md"}
    of_all_models = (pd.read_csv(where / "claims.csv") for where in (folder, RESULTS / "audit"))
    pd.testing.assert_frame_equal(*of_all_models)


def test_a_new_claim_is_a_row_of_the_table(copied, tmp_path, monkeypatch):
    row = "new,Results,It is as good as the mean shape.,deep_mds_over_mean_shape < 1.2,\n"
    file = tmp_path / "claims.csv"
    file.write_text(audit.CLAIMS.read_text() + row)
    monkeypatch.setattr(audit, "CLAIMS", file)
    new = judged(copied[0]).loc["new"]
    assert (new["verdict"], new["number"]) == (claims.REFUTED, "deep_mds_over_mean_shape")
    assert new["low"] > 1.2
    page = (audit.combine(copied[0].results) / "claims.md").read_text()
    assert "It is as good as the mean shape." in page
    assert page.count("| :-- |\n|") == page.count("\n## "), "rows follow the rule below the heads"


def test_the_authors_protocol_has_conditions_of_its_own_where_it_makes_a_difference(copied):
    fair, as_authors = (judged(copied[0], protocol) for protocol in ("faithful", "authors"))
    differ = fair.index[fair["supported_if"] != as_authors["supported_if"]]
    assert [*differ] == ["bfm-rank", "zhao-score", "celeba", "casia-comparable"]
    for claim in ("bfm-rank", "zhao-score", "celeba"):
        assert fair.loc[claim, "verdict"] == claims.REFUTED
        assert as_authors.loc[claim, "verdict"] == claims.SUPPORTED
    page = (audit.combine(copied[0].results) / "claims.md").read_text()
    assert f"**{claims.SUPPORTED} ({claims.INDICATIVE})**" in page


def test_what_was_not_run_is_not_testable(copied):
    run = copied[0]
    shutil.rmtree(run.experiment_results("seeds"))
    shutil.rmtree(run.experiment_results("ablation"))
    verdicts = judged(run)["verdict"]
    for claim in ("bfm-rank", "trivial-case", "training-luck", "mini-batches", "five-layers"):
        assert verdicts[claim] == claims.NOT_TESTABLE
    assert verdicts["celeba"] == claims.REFUTED


def test_a_method_as_good_as_claimed_is_supported(copied):
    run = copied[0]
    path = run.experiment_results("seeds") / "metrics.csv"
    table = pd.read_csv(path)
    better = (table["method"] == "deep_mds") & (table["metric"] == "mse")
    table.loc[better, "value"] = 0.5e-4 + 1e-8 * table.loc[better, "seed"]
    table.to_csv(path, index=False)
    verdicts = judged(run)["verdict"]
    assert verdicts["trivial-case"] == verdicts["training-luck"] == claims.SUPPORTED


@pytest.mark.parametrize("model", MODELS)
def test_numbers_agree_with_the_tables_that_documents_quote(model):
    numbers = pd.read_csv(RESULTS / model / "audit" / "numbers.csv").set_index("number")
    seeds = pd.read_csv(RESULTS / model / "seeds" / "metrics.csv")
    ours = seeds[(seeds["method"] == "deep_mds") & (seeds["metric"] == "mse")]["value"]
    assert numbers.loc["deep_mds_mse", "value"] == pytest.approx(ours.median())
    assert numbers.loc["deep_mds_mse", "low"] == pytest.approx(ours.sort_values().iloc[1])
    assert numbers.loc["seed_sd_mse", "value"] == pytest.approx(ours.std())
    assert numbers.loc["rank", "value"] == 4
    assert numbers.loc["least_p_value", "value"] == pytest.approx(2 / 2**10)
