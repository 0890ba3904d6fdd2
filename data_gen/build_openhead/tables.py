"""Where the tables of the build are: CSV with comments, beside this file."""

from __future__ import annotations

from pathlib import Path

HERE = Path(__file__).parent
IDENTITY_PRIOR = HERE / "identity_prior.csv"
KEPT_FACES = HERE / "kept_faces.csv"
LANDMARKS = HERE / "landmarks.csv"
