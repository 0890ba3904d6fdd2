"""The claims with their verdicts: `claims.csv`, and of all face models as Markdown and LaTeX."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from experiments.audit.checks import CHECKS
from experiments.audit.claims import Claim, described
from experiments.audit.findings import Finding
from experiments.markup.markdown import markdown
from experiments.records import write_text
from experiments.scoring.latex import tabular
from experiments.scoring.numbers import NOTHING
from experiments.scoring.tables import write_csv
from experiments.verdicts import VERDICTS, listed, read_claims, side_by_side

COLUMNS = ("id", "where", "claim", "check", "model", "verdict", "condition", "evidence")


def table_of(
    claims: Mapping[str, Claim], findings: Mapping[str, Finding], model: str
) -> pd.DataFrame:
    """`COLUMNS`, a row a claim; what holds comes first.

    Args:
        claims, findings: By the claim's id.
        model: Face model that was checked on.
    """
    rows = [
        (
            *(claim.id, claim.where, claim.claim, described(CHECKS[claim.id]), model),
            *(findings[claim.id].verdict, findings[claim.id].condition),
            findings[claim.id].evidence,
        )
        for claim in claims.values()
    ]
    return _sorted(pd.DataFrame(rows, columns=[*COLUMNS]))


def combine(root: Path, names: Mapping[str, str]) -> Path:
    """Write the claims of all face models side by side: `claims.csv`, `.md` and `.tex`.

    Args:
        root: `results`, in which `<model>/audit/claims.csv` are looked for.
        names: Face model to its name in texts.

    Returns:
        The folder, `results/audit`.
    """
    files = [root / model / "audit" / "claims.csv" for model in names]
    table = _sorted(pd.concat([read_claims(path) for path in files if path.exists()]))
    folder = root / "audit"
    write_csv(folder / "claims.csv", table)
    page = markdown("markup/claims_page.md.j2", of=listed(table, names))
    write_text(folder / "claims.md", page)
    write_text(folder / "claims.tex", latex(table, names))
    return folder


def latex(table: pd.DataFrame, names: Mapping[str, str]) -> str:
    r"""Claims and verdicts by face model, as a booktabs `longtable` to `\input`."""
    rows = side_by_side(table, names).fillna(NOTHING)
    models = len(rows.columns) - 2
    width = rf"{0.5 / models:.3f}\linewidth"
    columns = rf"p{{0.3\linewidth}}p{{0.14\linewidth}}*{{{models}}}{{p{{{width}}}}}"
    return tabular(rows, columns, over_pages=True)


def _sorted(table: pd.DataFrame) -> pd.DataFrame:
    """By how far a claim holds, on all face models together, then in the order of the checks."""
    places = table["verdict"].map(VERDICTS.index)
    keys = pd.DataFrame(
        {
            "place": places.groupby(table["id"]).transform("mean").to_numpy(),
            "claim": table["id"].map([*CHECKS].index).to_numpy(),
        }
    )
    return table.iloc[keys.sort_values(["place", "claim"], kind="stable").index].reset_index(
        drop=True
    )
