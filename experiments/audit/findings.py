"""Findings: the verdict of a check on a claim."""

from __future__ import annotations

from dataclasses import dataclass

from experiments.verdicts import DOES_NOT_HOLD, HOLDS, UNKNOWN, WITH_CONDITION

# Errors within this factor count as alike wherever the paper calls methods or views comparable.
ALIKE = 1.5
OTHER_FACTORS = (1.2, 2.0)  # with which verdicts are given beside


@dataclass(frozen=True)
class Finding:
    """Verdict on one claim.

    Attributes:
        verdict: One of `VERDICTS`.
        evidence: Sentences with the numbers that were measured.
        condition: Under which the claim holds, or what is missing to check it; else empty.
    """

    verdict: str
    evidence: str
    condition: str = ""


def holds(evidence: str) -> Finding:
    return Finding(HOLDS, evidence)


def holds_if(condition: str, evidence: str) -> Finding:
    """The claim holds under a condition, such as `"for yaws up to 45°"`."""
    return Finding(WITH_CONDITION, evidence, condition)


def unknown(missing: str, evidence: str = "") -> Finding:
    """The claim cannot be checked without something, such as `"the Basel Face Model 2009"`."""
    return Finding(UNKNOWN, evidence, missing)


def does_not_hold(evidence: str) -> Finding:
    return Finding(DOES_NOT_HOLD, evidence)
