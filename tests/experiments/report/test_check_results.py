"""`make check-results` sees digits that differ, rows that are gone, and what it cannot run."""

import json
import subprocess
from pathlib import Path

import pandas as pd
import pytest

from deepmds_keras.errors import InputError
from experiments.report import check_results
from experiments.report.check_results import Made, check, compare, find_results, main, small_run

TABLE = pd.DataFrame(
    {
        "method": ["ridge", "mlp", "mlp"],
        "metric": ["mse", "mse", "ms_per_face"],
        "mean": ["0.00012345", "0.5", "3.1"],
        "seconds": ["1", "2", "3"],
    }
)


@pytest.fixture
def folders(tmp_path):
    def write(table):
        folder = tmp_path / f"{len([*tmp_path.iterdir()])}"
        folder.mkdir()
        table.to_csv(folder / "table.csv", index=False)
        return folder

    return write


def test_times_may_differ(folders):
    now = TABLE.assign(seconds="9")
    now.loc[2, "mean"] = "4.2"
    assert compare(folders(TABLE), folders(now)) is None


def test_a_digit_that_differs_is_named(folders):
    now = TABLE.copy()
    now.loc[0, "mean"] = "0.00012346"
    found = compare(folders(TABLE), folders(now))
    assert found == "table.csv differs in 1 cells, first ridge, mse, 0.00012346"


def test_rows_and_tables_that_are_gone_are_named(folders, tmp_path):
    assert "other rows" in compare(folders(TABLE), folders(TABLE[1:]))
    (tmp_path / "empty").mkdir()
    assert compare(folders(TABLE), tmp_path / "empty") == "table.csv is gone"
    assert compare(tmp_path / "empty", tmp_path / "empty") == "no table to compare"


def test_results_are_listed_with_what_made_them(tmp_path, monkeypatch, capsys):
    made_by = "0123456789ab"
    for name in ("ict/bfm", "smoke/ict/bfm"):
        (tmp_path / name).mkdir(parents=True)
        manifest = {"command": "make reproduce-bfm", "commit": made_by, "steps": [{}, {}]}
        (tmp_path / name / "manifest.json").write_text(json.dumps(manifest))
    (made,) = find_results(tmp_path)
    assert (str(made.folder), made.commits) == ("ict/bfm", (made_by,))
    whole = made_by + "c" * 28
    monkeypatch.setattr(
        check_results, "git", lambda *words, folder: made_by if "--short=12" in words else whole
    )
    monkeypatch.setattr(check_results, "small_run", None)  # the last commit's are not run again
    monkeypatch.setattr(check_results, "find_results", lambda _: [made])
    with pytest.raises(SystemExit, match="False"):
        main()
    assert capsys.readouterr().out == f"ict/bfm: {made_by}, the last commit: the same digits\n"


def test_a_commit_that_git_does_not_know_is_not_checked(monkeypatch, tmp_path):
    def git(*words, folder):
        raise subprocess.CalledProcessError(128, words)

    monkeypatch.setattr(check_results, "_TREES", tmp_path)
    monkeypatch.setattr(check_results, "git", git)
    made = Made(Path("ict/bfm"), ("0123456789ab+",), "make reproduce-bfm")
    assert check(made, "0123456789ab+", "b" * 12) == (
        "0123456789ab+: not checked: 0123456789ab+ is no commit of this clone"
    )


def test_what_cannot_be_run_is_said_not_passed(monkeypatch, tmp_path):
    monkeypatch.setattr(check_results, "_TREES", tmp_path)
    made = Made("x", ("c" * 12,), "make lifting MODEL=ict DATA=no/such/folder")
    (tmp_path / "cccccccccccc" / "experiments").mkdir(parents=True)
    with pytest.raises(InputError, match="has no command that runs"):
        small_run(made, "c" * 12)
    (tmp_path / "cccccccccccc" / "experiments" / "make.py").touch()
    with pytest.raises(InputError, match="DATA=no/such/folder not found"):
        small_run(made, "c" * 12)
    assert check(made, "c" * 12, "d" * 12) == (
        "cccccccccccc: not checked: DATA=no/such/folder not found"
    )
