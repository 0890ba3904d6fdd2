"""The audit's claims and verdicts as blocks, for one face model or several."""

from __future__ import annotations

import pandas as pd

from experiments.markup.blocks import Block, Cell, Column, Fold, Heading, Listing, Paragraph, Table
from experiments.verdicts import VERDICTS, counted, phrase

_COLOURS = dict(zip(VERDICTS, ("#2E7D32", "#9CCC65", "#BDBDBD", "#C62828"), strict=True))
_READING = (
    "Every verdict is computed by the check that is named with it, on the faces of the model that "
    "is named with it, which are not the paper's. Claims that hold come first. Where the text "
    "leaves its meaning open, the evidence has the reading that favours it, too; a cause that is "
    "inferred and not proven is said to be. “A reviewer's question” is no claim of the paper."
)


def claim_blocks(table: pd.DataFrame, names: dict[str, str]) -> list[Block]:
    """Verdicts side by side, then the evidence of each.

    Args:
        table: As `claims.csv`, empty cells as empty strings.
        names: Face model to its name in texts.
    """
    models = [model for model in names if model in {*table["model"]}]
    columns = (
        Column("Claim", numeric=False),
        Column("Where", numeric=False),
        *(Column(names[model], numeric=False) for model in models),
    )
    rows, evidence = [], []
    for _, own in table.groupby("id", sort=False):
        own = own.set_index("model")
        first = own.iloc[0]
        verdicts = (_verdict(own, model) for model in models)
        rows.append((Cell(first["claim"]), Cell(first["where"]), *verdicts))
        evidence += [
            Paragraph(f"**{first['claim']}** {first['where']}. `{first['check']}`"),
            Listing(tuple(_evidence(own.loc[m], names[m]) for m in models if m in own.index)),
        ]
    counts = [f"On {names[m]} {counted(table[table['model'] == m])}." for m in models]
    return [
        Paragraph(_READING),
        Paragraph(f"Of {len(rows)} claims: {' '.join(counts)}"),
        Table("Verdicts.", columns, tuple(rows)),
        Fold("Evidence of every verdict", tuple(evidence)),
    ]


def claims_page(table: pd.DataFrame, names: dict[str, str]) -> list[Block]:
    """The same as a page of its own."""
    return [
        Heading(1, "Which claims of the paper hold", "claims"),
        *claim_blocks(table, names),
    ]


def _verdict(own: pd.DataFrame, model: str) -> Cell:
    if model not in own.index:
        return Cell("not run")
    row = own.loc[model]
    place = float(VERDICTS.index(row["verdict"]))
    return Cell(phrase(row["verdict"], row["condition"]), place, colour=_COLOURS[row["verdict"]])


def _evidence(row: pd.Series, name: str) -> str:
    said = phrase(row["verdict"], row["condition"])
    return f"{name}: **{said}**. {row['evidence']}".strip()
