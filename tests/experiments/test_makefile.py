"""What `make` would run: what is missing, and nothing that is there."""

import subprocess

import pytest
from places import ROOT


@pytest.fixture
def would_run(tmp_path):
    """Stages that `make reproduce-bfm` would run after all but those of MobileFace are done."""
    (tmp_path / "venv").mkdir()
    for record in ("faces", "networks", "predictions", "bfm"):
        (tmp_path / f"{record}.json").touch()
    (tmp_path / "venv" / ".ready").touch()

    return lambda *variables: stages_of(tmp_path, "reproduce-bfm", "BUILD", *variables)


def stages_of(folder, target, build, *variables):
    """Stages in the order of `make -n`, or what it complains of."""
    command = ["make", "-n", target, f"{build}={folder}", f"VENV={folder}/venv"]
    command += [f"MEDIAPIPE_VENV={folder}/venv", *variables]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    words = done.stdout.split()
    stages = [stage for word, stage in zip(words, words[1:], strict=False) if word == "experiments"]
    return stages if done.returncode == 0 else done.stderr


def test_only_what_is_missing_is_run(would_run, tmp_path):
    assert would_run("MOBILEFACE=no") == ["show"]
    assert would_run() == ["images", "mobileface", "bfm", "show"]
    assert would_run("MOBILEFACE=no", "AUTHORS=x") == ["predictions", "bfm", "show"]
    assert would_run("MOBILEFACE=no", "EVALUATOR=released") == ["bfm", "show"]
    (tmp_path / "networks.json").unlink()
    assert would_run("MOBILEFACE=no") == ["networks", "predictions", "bfm", "show"]


def test_the_audit_always_runs_after_what_it_needs(tmp_path, would_run):
    def stages(target):
        return stages_of(tmp_path, target, "BUILD", "MOBILEFACE=no")

    assert stages("ablation") == ["ablation"]
    assert stages("audit") == ["ablation", "audit"]
    (tmp_path / "ablation.json").touch()
    assert stages("ablation") == ["ablation"]
    assert stages("audit") == ["audit"]
    (tmp_path / "predictions.json").unlink()
    assert stages("audit") == ["predictions", "bfm", "audit"]


def test_a_word_that_is_neither_yes_nor_no_is_refused(would_run):
    assert "MOBILEFACE must be yes or no. Received nein" in would_run("MOBILEFACE=nein")


def test_the_flame_track_runs_what_is_missing(tmp_path):
    (tmp_path / "venv").mkdir()
    (tmp_path / "venv" / ".ready").touch()

    def would_run(*variables):
        return stages_of(tmp_path, "reproduce-flame", "FLAME", *variables)

    assert {*would_run()} == {
        *("frames", "networks", "scans", "predictions", "mediapipe", "rings", "ringnet"),
        *("flame", "show"),
    }
    for record in ("frames", "networks", "scans", "predictions", "flame"):
        (tmp_path / f"{record}.json").touch()
    assert would_run("RINGNET=no", "MEDIAPIPE=no") == ["show"]
    assert would_run("RINGNET=no") == ["mediapipe", "flame", "show"]
    assert would_run("MEDIAPIPE=no") == ["rings", "ringnet", "flame", "show"]
    assert would_run("MEDIAPIPE=no", "RINGNET=x/ring_6_68641") == ["ringnet", "flame", "show"]
    assert "MEDIAPIPE must be yes or no. Received x" in would_run("MEDIAPIPE=x")


def test_celeba_is_found_in_data_and_has_a_folder_of_its_own(tmp_path):
    (tmp_path / "venv").mkdir()
    (tmp_path / "venv" / ".ready").touch()
    (tmp_path / "data" / "CelebA" / "img_align_celeba").mkdir(parents=True)

    def said(*variables):
        command = ["make", "-n", "reproduce-celeba", f"VENV={tmp_path}/venv", *variables]
        return subprocess.run(command, cwd=ROOT, capture_output=True, text=True).stdout

    for given in (f"DATA={tmp_path}/data", f"DATA={tmp_path}/data/CelebA",
                  f"CELEBA={tmp_path}/data/CelebA"):  # fmt: skip
        assert f"--celeba '{tmp_path}/data/CelebA'" in said(given), given
    assert "--celeba ''" in said() and "--celeba ''" in said("MODEL=ict", "DATA=data/ict-facekit")


def test_the_celeba_experiment_takes_the_networks_of_the_bfm_track(tmp_path):
    (tmp_path / "venv").mkdir()
    (tmp_path / "venv" / ".ready").touch()
    bfm = tmp_path / "bfm"
    bfm.mkdir()
    for record in ("faces", "images", "networks", "mobileface"):
        (bfm / f"{record}.json").touch()

    def would_run(*variables):
        return stages_of(tmp_path, "reproduce-celeba", "PHOTOS", f"BUILD={bfm}", *variables)

    assert {*would_run()} == {"photos", "predictions", "mobileface", "celeba", "show"}
    assert "mobileface" not in would_run("MOBILEFACE=no")
    figure = would_run("MOBILEFACE=no", "TF_FLAME=x", "RINGNET=no", "MEDIAPIPE=no",
                       f"FLAME={tmp_path}/flame")  # fmt: skip
    assert {"frames", "networks", "celeba_flame"} <= {*figure} and "ringnet" not in figure
