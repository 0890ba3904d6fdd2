"""Verdicts on the claims of the paper: what the audit writes to `claims.csv` and others read."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

HOLDS = "holds"
WITH_CONDITION = "holds with a condition"
UNKNOWN = "cannot be checked"
DOES_NOT_HOLD = "does not hold"
# As they are listed: what holds comes first.
VERDICTS = (HOLDS, WITH_CONDITION, UNKNOWN, DOES_NOT_HOLD)
_PLURALS = ("hold", "hold with a condition", "cannot be checked", "do not hold")
_BEFORE_CONDITION = {WITH_CONDITION: "holds", UNKNOWN: "cannot be checked without"}


def read_claims(path: Path) -> pd.DataFrame:
    """Return a `claims.csv`, empty cells as empty strings."""
    return pd.read_csv(path, dtype=str, keep_default_na=False)


def phrase(verdict: str, condition: str) -> str:
    """Return verdict and condition as one: `"holds for yaws up to 45°"`."""
    return f"{_BEFORE_CONDITION[verdict]} {condition}" if condition else verdict


def counted(table: pd.DataFrame) -> str:
    """Return how many claims got each verdict: `"12 hold, 5 hold with a condition, …"`."""
    counts = table["verdict"].value_counts()
    return ", ".join(
        f"{counts[verdict]} {verdict if counts[verdict] == 1 else plural}"
        for verdict, plural in zip(VERDICTS, _PLURALS, strict=True)
        if verdict in counts
    )
