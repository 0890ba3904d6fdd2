"""What steps print besides their results: bars on a terminal, lines under `make` and in a log."""

import fcntl
import os
import pty
import struct
import subprocess
import sys
import termios
from pathlib import Path

import pytest
import runs

from experiments import progress
from experiments.progress import Progress
from experiments.progress.step_names import in_words

_BARS = """
import time
from experiments.progress import Progress
with Progress("face", 3) as progress:
    time.sleep(2.1)
    progress.update(3)
"""


@pytest.fixture
def clock(monkeypatch):
    """Seconds of the clock of progress, to be set."""
    seconds = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: seconds[0])
    monkeypatch.setattr(Progress, "step", "")  # whatever a step that ran here has left
    return seconds


def test_a_log_gets_a_line_every_half_minute_with_the_time_left(clock, monkeypatch, capsys):
    monkeypatch.setattr(Progress, "step", "train MobileFace")
    shown = Progress("epoch", 60)
    for clock[0] in range(20, 1201, 20):
        shown.update()
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "train MobileFace: epoch 2 of 60, about 19 min left"
    assert len(lines) == 29 and lines[-1].endswith("epoch 58 of 60, about 40 s left")


def test_what_an_earlier_run_has_done_takes_no_time(clock, capsys):
    shown = Progress("autoencoder: epoch", 60)
    for clock[0] in (0.01, 0.02, 60.0, 120.0):
        shown.update(20 if clock[0] < 1 else 1)
    assert capsys.readouterr().out.splitlines() == [
        "autoencoder: epoch 41 of 60, about 19 min left",
        "autoencoder: epoch 42 of 60, about 18 min left",
    ]


@pytest.mark.parametrize("under_make", [False, True])
def test_a_terminal_gets_a_bar_unless_steps_share_it(under_make):
    terminal, child = pty.openpty()
    fcntl.ioctl(child, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    environment = runs.ENVIRONMENT | ({progress.PARENT: "1@elsewhere"} if under_make else {})
    subprocess.run([sys.executable, "-c", _BARS], stderr=child, check=True, env=environment)
    os.write(child, b"end")
    os.close(child)
    assert (b"face: 100%" in os.read(terminal, 10_000)) != under_make
    os.close(terminal)


@pytest.mark.parametrize(
    ("seconds", "text"), [(3, "10 s"), (84, "80 s"), (95, "2 min"), (5700, "1 h 35 min")]
)
def test_an_estimate_has_no_more_digits_than_it_knows(seconds, text):
    assert progress.roughly(seconds) == text


@pytest.mark.parametrize(
    ("record", "words"),
    [
        ("bfm-full-paper-seed0/records/train-deep_mds_cosine.json",
         "train Deep-MDS (cosine schedule)"),
        ("bfm-full-paper-seed3/records/predict-deep_mds.json", "predict with Deep-MDS, seed 3"),
        ("bfm-full-paper-seed0/records/variant-two_layers_cosine-seed4.json",
         "train for the ablation: two layers cosine, seed 4"),
        ("bfm-full-paper-seed0/records/scale-0.75-seed1.json",
         "train on faces of scale: 0.75, seed 1"),
        ("bfm-full-paper-seed0/records/object-chairs-seed2.json", "train on: chairs, seed 2"),
        ("bfm-full-paper-seed0/records/stream-50000-100000.json",
         "score some of many faces: 50000 to 100000"),
        ("flame-full-paper-seed0-coma/records/scans.json",
         "find landmarks in photos and on scans"),
    ],
)  # fmt: skip
def test_a_step_has_the_name_that_readers_know(record, words):
    assert in_words(Path(record)) == words


def preview(folder, stdout, **variables):
    return subprocess.run(
        [sys.executable, "-m", "experiments", "tracks.preview", "ridge", "--preset", "tiny"],
        cwd=folder, env=runs.ENVIRONMENT | variables, stdout=stdout, stderr=subprocess.PIPE,
        text=True,
    )  # fmt: skip


def test_a_reader_that_leaves_ends_a_step_without_a_traceback(whole_bfm):
    reader, writer = os.pipe()
    os.close(reader)
    done = preview(whole_bfm, writer)
    os.close(writer)
    assert (done.returncode, done.stderr) == (141, "")


def test_a_terminal_without_special_characters_gets_the_table(whole_bfm):
    done = preview(whole_bfm, subprocess.PIPE, PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, "")
    assert r"10\u207b" in done.stdout, "an escaped power of ten"
