"""The audit at the smallest size: topics are measured, collected and judged."""

import json
import shutil

import pandas as pd
import pytest
import runs

from experiments.audit.audit import judge
from experiments.audit.claims import NOT_TESTABLE, REFUTED
from experiments.audit.measure import TOPICS
from experiments.methods import methods_of
from experiments.run import Run

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def audited(whole_bfm, tmp_path_factory):
    folder = shutil.copytree(whole_bfm, tmp_path_factory.mktemp("audit") / "whole")
    for topic in TOPICS:
        runs.succeed("audit.measure", folder, topic, *(m.id for m in methods_of(Run())))
    runs.succeed("audit.audit", folder, *TOPICS)
    return folder


def test_every_topic_and_number_is_in_the_results(audited):
    folder = runs.results(audited, "audit")
    manifest = json.loads((folder / "manifest.json").read_text())
    # Without claims: a small size gives no verdicts.
    tables = {"numbers", "curves", *TOPICS} - {"poses", "noise"}
    assert {f"{name}.csv" for name in tables} | {
        f"figures/{name}.{ending}" for name in ("poses", "noise") for ending in ("png", "pdf")
    } == manifest["files"].keys()
    assert not (audited / "results" / "tiny" / "audit").exists()
    judged = judge(pd.read_csv(folder / "numbers.csv"), "openhead")
    verdicts = judged.groupby("id")["verdict"].agg(list)  # one by each protocol
    # What no size of the experiment changes; and what takes seeds.
    assert verdicts["distance-rank"] == verdicts["p-values"] == [REFUTED] * 2
    assert verdicts["trivial-case"] == [NOT_TESTABLE] * 2


def test_a_topic_that_there_is_not_is_named(tmp_path):
    done = runs.run("audit.measure", tmp_path, "luck")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "TOPIC must be one of poses, " in done.stderr
