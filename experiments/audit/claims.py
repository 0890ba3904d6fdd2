"""Every claim: where the paper makes it, in `results/published/claims.csv`, and its check here."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd

from deepmds_keras.io.errors import InputError
from experiments.audit.findings import ALIKE, OTHER_FACTORS, Finding
from experiments.scoring.numbers import enumeration
from experiments.verdicts import UNKNOWN, phrase

CLAIMS_FILE = Path(__file__).parents[2] / "results" / "published" / "claims.csv"


@dataclass(frozen=True)
class Claim:
    """A claim of the paper.

    Attributes:
        id: Its name.
        where: Section or table of the paper that makes it; for what a reviewer would ask beside
            the paper's claims, that.
        claim: In our words.
        numbers: Those of the claim that its check needs, by name, beside those in
            `results/published/published.csv`.
    """

    id: str
    where: str
    claim: str
    numbers: dict[str, float]


def load_claims(path: Path = CLAIMS_FILE) -> dict[str, Claim]:
    """Claims by id, in the order of the file.

    Raises:
        InputError: An id is there twice, or numbers are not `name=value`, separated by `;`.
    """
    rows = pd.read_csv(path, dtype=str, keep_default_na=False)
    if rows["id"].duplicated().any():
        raise InputError(
            f"{path} must name each claim once. "
            f"Received {', '.join(rows['id'][rows['id'].duplicated()])} twice."
        )
    return {
        row.id: Claim(row.id, row.where, row.claim, _numbers(row.numbers, path))
        for row in rows.itertuples()
    }


def judge(claim: Claim, check: Callable[..., Finding], measured: Mapping) -> Finding:
    """Run a check on those of the measured numbers, and of the claim's, that it names.

    Where it asks what counts as alike, the evidence says what a smaller and a larger factor give.
    """
    known = {**measured, **claim.numbers}
    given = {name: known[name] for name in _inputs(check)}
    finding = check(**given)
    if "alike" not in inspect.signature(check).parameters or finding.verdict == UNKNOWN:
        return finding
    others = {factor: check(**given, alike=factor) for factor in OTHER_FACTORS}
    said = (f'with {factor:g} the verdict is "{phrase(own.verdict, own.condition)}"'
            for factor, own in others.items())  # fmt: skip
    return replace(
        finding,
        evidence=f"{finding.evidence} Errors within a factor of {ALIKE:g} count as alike; "
        f"{enumeration([*said])}.",
    )


def described(check: Callable[..., Finding]) -> str:
    """A check and its inputs as they are called: `parameters.ours(trainable, total)`."""
    module = check.__module__.rpartition(".")[2]
    return f"{module}.{check.__name__}({', '.join(_inputs(check))})"


def _inputs(check: Callable[..., Finding]) -> list[str]:
    return [name for name in inspect.signature(check).parameters if name != "alike"]


def _numbers(text: str, path: Path) -> dict[str, float]:
    try:
        pairs = [part.split("=") for part in text.split(";") if part.strip()]
        return {name.strip(): float(value) for name, value in pairs}
    except ValueError:
        raise InputError(
            f"{path}: numbers must be name=value; name=value. Received {text}."
        ) from None
