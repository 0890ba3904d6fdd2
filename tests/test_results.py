"""Committed results belong together: of one commit, and the files that their manifest lists."""

import hashlib

import pytest
from places import committed

from experiments.records import commits_of, read_manifest

RESULTS = committed() / "results"
FOLDERS = sorted(path.parent.relative_to(RESULTS) for path in RESULTS.rglob("manifest.json"))


# Begun at one commit and ended at another; between them no step changed that had been run.
_SCORED_LATER = (
    "bfm", "bfm-evaluator-released", "celeba", "celeba-true-landmarks", "parameters",
)  # fmt: skip
OF_SEVERAL_COMMITS = (
    {f"{model}/{name}": 2 for model in ("openhead", "ict") for name in _SCORED_LATER}
    | {f"bfm68/{name}": 2 for name in ("bfm", "parameters", "seeds")}
    | {
        "bfm68/scales": 3,
        "openhead/pretrained": 2,  # the network is trained before what it is measured with is made
        "openhead/stream": 2,
        # Its networks are trained before fewer faces became enough.
        "openhead/lifting/component-ablation": 2,
        "ict/lifting/component-ablation": 2,
        "objects": 3,
    }
)


@pytest.mark.parametrize("folder", FOLDERS, ids=str)
def test_every_table_is_of_one_clean_commit(folder):
    commits = commits_of(read_manifest(RESULTS / folder))
    assert not any(commit.endswith("+") for commit in commits)
    assert len(commits) == OF_SEVERAL_COMMITS.get(str(folder), 1)


@pytest.mark.parametrize("folder", FOLDERS, ids=str)
def test_every_file_is_the_one_that_the_manifest_lists(folder):
    files = read_manifest(RESULTS / folder)["files"]
    for name, digest in files.items():
        content = (RESULTS / folder / name).read_bytes()
        assert hashlib.sha256(content).hexdigest() == digest, name
