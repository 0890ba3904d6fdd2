"""Committed results belong together: of one commit, and the files that their manifest lists."""

import hashlib

import pytest
from places import committed

from experiments.records import commits_of, read_manifest

RESULTS = committed() / "results"
FOLDERS = sorted(path.parent.relative_to(RESULTS) for path in RESULTS.rglob("manifest.json"))


# Begun at 84a3afc and ended at 91b48fe; between them no step changed that had been run.
OF_TWO_COMMITS = {f"bfm68/{name}" for name in ("bfm", "parameters", "seeds")}


@pytest.mark.parametrize("folder", FOLDERS, ids=str)
def test_every_table_is_of_one_clean_commit(folder):
    commits = commits_of(read_manifest(RESULTS / folder))
    assert not any(commit.endswith("+") for commit in commits)
    assert len(commits) == 1 + (str(folder) in OF_TWO_COMMITS)


@pytest.mark.parametrize("folder", FOLDERS, ids=str)
def test_every_file_is_the_one_that_the_manifest_lists(folder):
    files = read_manifest(RESULTS / folder)["files"]
    for name, digest in files.items():
        content = (RESULTS / folder / name).read_bytes()
        assert hashlib.sha256(content).hexdigest() == digest, name
