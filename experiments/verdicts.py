"""Verdicts on the claims of the paper: what the audit writes to `claims.csv` and others read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from experiments.markup.markdown import Table

HOLDS = "holds"
WITH_CONDITION = "holds with a condition"
UNKNOWN = "cannot be checked"
DOES_NOT_HOLD = "does not hold"
# As they are listed: what holds comes first.
VERDICTS = (HOLDS, WITH_CONDITION, UNKNOWN, DOES_NOT_HOLD)
_PLURALS = ("hold", "hold with a condition", "cannot be checked", "do not hold")
COLOURS = dict(zip(VERDICTS, ("#2E7D32", "#9CCC65", "#BDBDBD", "#C62828"), strict=True))
_BEFORE_CONDITION = {WITH_CONDITION: "holds", UNKNOWN: "cannot be checked without"}


def read_claims(path: Path) -> pd.DataFrame:
    """Return a `claims.csv`, empty cells as empty strings."""
    return pd.read_csv(path, dtype=str, keep_default_na=False)


def phrase(verdict: str, condition: str) -> str:
    """Return verdict and condition as one: `"holds for yaws up to 45°"`."""
    return f"{_BEFORE_CONDITION[verdict]} {condition}" if condition else verdict


def verdict_of(said: str) -> str | None:
    """Return the verdict of what `phrase` says, or None."""
    begun = (
        verdict for verdict, words in _BEFORE_CONDITION.items() if said.startswith(f"{words} ")
    )
    return said if said in VERDICTS else next(begun, None)


def counted(table: pd.DataFrame) -> str:
    """Return how many claims got each verdict: `"12 hold, 5 hold with a condition, …"`."""
    counts = table["verdict"].value_counts()
    return ", ".join(
        f"{counts[verdict]} {verdict if counts[verdict] == 1 else plural}"
        for verdict, plural in zip(VERDICTS, _PLURALS, strict=True)
        if verdict in counts
    )


def side_by_side(table: pd.DataFrame, titles: Mapping[str, str]) -> pd.DataFrame:
    """Return claims and verdicts, a column a face model; NaN where a claim was not checked.

    Args:
        table: As `claims.csv`, of one face model or several.
        titles: Face model to its name in texts, in the order of the columns.
    """
    said = table.assign(said=[*map(phrase, table["verdict"], table["condition"])])
    said = said.pivot(index="id", columns="model", values="said")
    claims = table.drop_duplicates("id").set_index("id")[["claim", "where"]]
    wide = claims.join(said[[model for model in titles if model in said]])
    return wide.rename(columns={"claim": "Claim", "where": "Where", **titles})


def listed(table: pd.DataFrame, titles: Mapping[str, str]) -> dict:
    """Return what `markup/claims.md.j2` shows of claims, with arguments as `side_by_side`."""
    verdicts = side_by_side(table, titles)
    by_model = {model: own for model, own in table.groupby("model")}
    evidence = {}
    for row in table.itertuples():
        said = f"{titles[row.model]}: **{phrase(row.verdict, row.condition)}**. {row.evidence}"
        head = f"**{row.claim}** {row.where}. `{row.check}`"
        evidence.setdefault(row.id, (head, []))[1].append(said.strip())
    return {
        "verdicts": Table("Verdicts.", verdicts.fillna("not run"), (*verdicts.columns,)),
        "counts": [f"On {titles[m]} {counted(by_model[m])}." for m in titles if m in by_model],
        "evidence": [*evidence.values()],
    }
