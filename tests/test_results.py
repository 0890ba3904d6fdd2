"""Committed results are of the code as it is, and belong together."""

import json
from collections import defaultdict

import pytest
from places import ROOT

from experiments.code_hash import code_hash
from experiments.manifest import modules_of

RESULTS = ROOT / "results"
MANIFESTS = {
    path.parent.relative_to(RESULTS).as_posix(): json.loads(path.read_text())
    for path in sorted(RESULTS.rglob("manifest.json"))
}


@pytest.mark.parametrize("folder", MANIFESTS)
def test_results_are_of_the_code_as_it_is(folder):
    made = MANIFESTS[folder]
    now = code_hash(modules_of(made["stages"]))
    assert made["code_sha256"] == now, f"{folder} is of other code: run `{made['command']}`"


def test_stages_are_of_one_clean_commit_in_all_results():
    commits = defaultdict(set)
    for made in MANIFESTS.values():
        for record in made["stages"]:
            commits[record["stage"]].add(made["commit"])
    for stage, own in commits.items():
        (commit,) = own
        assert not commit.endswith("+"), stage
