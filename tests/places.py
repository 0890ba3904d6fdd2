"""Where things are that are not made by the tests."""

from __future__ import annotations

from pathlib import Path

from deepmds_keras.detection.mediapipe_models import has_face_mesh

ROOT = Path(__file__).parents[1]
# Reference material beside the repository; tests that need it skip where it is not.
SHARED = ROOT.parent / "shared"
MEDIAPIPE = has_face_mesh()
