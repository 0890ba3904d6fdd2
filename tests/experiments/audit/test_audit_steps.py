"""The audit at the smallest size: topics are measured, collected and judged."""

import json
import shutil

import pandas as pd
import pytest
import runs

from experiments.audit.measure import TOPICS

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def audited(whole_bfm, tmp_path_factory):
    folder = shutil.copytree(whole_bfm, tmp_path_factory.mktemp("audit") / "whole")
    for topic in TOPICS:
        runs.succeed("audit.measure", folder, topic)
    runs.succeed("audit.audit", folder, *TOPICS)
    return folder


def test_every_topic_and_claim_is_in_the_results(audited):
    folder = runs.results(audited, "audit")
    manifest = json.loads((folder / "manifest.json").read_text())
    tables = {"claims", "numbers", "curves", *TOPICS} - {"poses", "noise"}
    assert {f"{name}.csv" for name in tables} | {
        f"figures/{name}.{ending}" for name in ("poses", "noise") for ending in ("png", "pdf")
    } == manifest["files"].keys()
    verdicts = pd.read_csv(folder / "claims.csv").set_index("id")["verdict"]
    # What no size of the experiment changes; and what takes seeds.
    assert verdicts["distance-rank"] == verdicts["p-values"] == "not supported"
    assert verdicts["trivial-case"] == "not testable here"


def test_topics_that_are_not_there_are_named(tmp_path):
    done = runs.run("audit.measure", tmp_path, "luck")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "TOPIC must be one of poses, " in done.stderr
    done = runs.run("audit.audit", tmp_path, *TOPICS)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "audit.measure poses" in done.stderr
