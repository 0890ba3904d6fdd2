"""Where things are that are not made by the tests."""

from __future__ import annotations

import atexit
import functools
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from deepmds_keras.tool.detection.mediapipe_landmarks import has_mediapipe

ROOT = Path(__file__).parents[1]
# Reference material next to the repository; tests that need it skip where it is not.
SHARED = ROOT.parent / "shared"
MEDIAPIPE = has_mediapipe()


@functools.cache
def committed() -> Path:
    """Folder with pages and results as git has them: a user's runs are no concern of tests.

    As they are staged, so that a change can be tested before it is committed; without git, as they
    are.
    """
    listed = ["git", "ls-files", "-z", "README.md", "THIRD_PARTY_NOTICES.md", "docs", "results"]
    try:
        files = subprocess.run(listed, cwd=ROOT, capture_output=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return ROOT
    folder = tempfile.mkdtemp(prefix="committed-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    checkout = ["git", "checkout-index", "-z", "--stdin", f"--prefix={folder}/"]
    subprocess.run(checkout, cwd=ROOT, input=files, check=True)
    return Path(folder)


def python(*words, folder=ROOT, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run Python on the repository: words of its command line, variables of its environment."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)} | variables
    words = [sys.executable, *map(str, words)]
    return subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True)
