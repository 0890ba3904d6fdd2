"""What steps print besides their results: bars on a terminal, nothing of them in a log."""

import fcntl
import os
import pty
import struct
import subprocess
import sys
import termios

import runs

_BARS = """
from experiments.progress import Bar, EpochBar
with Bar(total=3, desc="faces", unit="face", mininterval=0) as bar:
    bar.update(3)
with EpochBar("ours", 2) as bar:
    bar.delay = 0
    bar.losses({"train": 0.04})
"""


def test_a_log_gets_no_bar():
    done = subprocess.run([sys.executable, "-c", _BARS], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_a_terminal_gets_one():
    terminal, child = pty.openpty()
    fcntl.ioctl(child, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    subprocess.run([sys.executable, "-c", _BARS], stderr=child, check=True)
    os.close(child)
    assert b"faces: 100%" in os.read(terminal, 10_000)
    os.close(terminal)


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
