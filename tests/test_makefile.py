"""What `make` would run: what is missing, and nothing that is there."""

import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture
def would_run(tmp_path):
    """Stages that `make reproduce-bfm` would run after all but those of MobileFace are done."""
    (tmp_path / "venv").mkdir()
    for record in ("faces", "networks", "predictions", "bfm"):
        (tmp_path / f"{record}.json").touch()
    (tmp_path / "venv" / ".ready").touch()

    def run(*variables):
        command = ["make", "-n", "reproduce-bfm", f"BUILD={tmp_path}", f"VENV={tmp_path}/venv"]
        done = subprocess.run([*command, *variables], cwd=ROOT, capture_output=True, text=True)
        words = done.stdout.split()
        stages = [w.split(".")[1] for w in words if w.startswith("experiments.")]
        return stages if done.returncode == 0 else done.stderr

    return run


def test_only_what_is_missing_is_run(would_run, tmp_path):
    assert would_run("MOBILEFACE=no") == ["show"]
    assert would_run() == ["images", "mobileface", "bfm", "show"]
    assert would_run("MOBILEFACE=no", "AUTHORS=x") == ["predictions", "bfm", "show"]
    assert would_run("MOBILEFACE=no", "EVALUATOR=released") == ["bfm", "show"]
    (tmp_path / "networks.json").unlink()
    assert would_run("MOBILEFACE=no") == ["networks", "predictions", "bfm", "show"]


def test_a_word_that_is_neither_yes_nor_no_is_refused(would_run):
    assert "MOBILEFACE must be yes or no. Received nein" in would_run("MOBILEFACE=nein")
