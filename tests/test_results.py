"""Committed results are of the code as it is, from one clean commit."""

import json

import pytest
from places import ROOT

from experiments.code_hash import code_hash
from experiments.manifest import modules_of

RESULTS = ROOT / "results"
# Folders whose results are of earlier code, until they are made anew. A change of code that makes
# results anew takes a run of what it changed, or an entry here.
EARLIER = ("openhead/pretrained",)


MANIFESTS = {
    path.parent.relative_to(RESULTS).as_posix(): json.loads(path.read_text())
    for path in sorted(RESULTS.rglob("manifest.json"))
}


@pytest.mark.parametrize("folder", MANIFESTS)
def test_results_are_of_the_code_as_it_is(folder):
    made = MANIFESTS[folder]
    same = made.get("code_sha256") == code_hash(modules_of(made["stages"]))
    if folder in EARLIER:
        assert not same, f"{folder} is of this code: take it out of EARLIER"
    else:
        assert same, f"{folder} is of other code: run `{made['command']}`, or name it in EARLIER"


def test_results_are_of_one_clean_commit():
    commits = {made["commit"] for folder, made in MANIFESTS.items() if folder not in EARLIER}
    assert len(commits) <= 1
    assert not any(commit.endswith("+") for commit in commits)
