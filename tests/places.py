"""Where things are that are not made by the tests."""

from __future__ import annotations

import os
from pathlib import Path

ROOT = Path(__file__).parents[1]
# Reference material beside the repository; tests that need it skip where it is not.
SHARED = ROOT.parent / "shared"
# The interpreter of MediaPipe's environment.
MEDIAPIPE = Path(os.environ.get("MEDIAPIPE_PYTHON", ROOT / ".venv-mediapipe/bin/python"))
