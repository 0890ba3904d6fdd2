"""The numbers that the paper prints, from `results/published/published.csv`."""

from __future__ import annotations

import functools
import math
from decimal import Decimal
from pathlib import Path

import pandas as pd

from deepmds_keras.io.errors import InputError

PUBLISHED = Path(__file__).parents[1] / "results" / "published" / "published.csv"

# What the paper says of an experiment: its table and where else the text gives a number for it.
SOURCES = {
    "bfm": ("tab:cmp_bfm", "text:bfm"),
    "celeba": ("tab:cmp_celebA_bfm",),
    "flame": ("tab:cmp_casia", "text:casia"),
    "parameters": ("tab:cmp_param",),
}


def published(experiment: str, path: Path = PUBLISHED) -> pd.DataFrame:
    """The paper's numbers for an experiment, in plain units.

    Args:
        experiment: `"bfm"`, `"celeba"`, `"flame"` or `"parameters"`.
        path: The transcription.

    Returns:
        A row for each method and metric: `method`, `metric`, `paper_mean`, `paper_std` (NaN where
        none is printed) and `paper_note`. 1.4 in units of 1e-4 is 1.4e-4; depth correlations stay
        as printed, since the paper's "%" is a sum over landmarks.

    Raises:
        InputError: Unknown experiment.
    """
    rows = _rows(experiment, path)
    rows = rows[(rows["method"] != "") & (rows["value"] != "")]
    return pd.DataFrame(
        {
            "method": rows["method"],
            "metric": rows["metric"],
            "paper_mean": [*map(float, map(_plain, rows["value"], rows["unit"]))],
            "paper_std": [*map(float, map(_plain, rows["uncertainty"], rows["unit"]))],
            "paper_note": rows["note"],
        }
    ).reset_index(drop=True)


def printed(experiment: str, metric: str, path: Path = PUBLISHED) -> dict[str, str]:
    """Cells of a metric as the paper prints them, by method; for what is no number.

    Raises:
        InputError: Unknown experiment.
    """
    rows = _rows(experiment, path)
    rows = rows[rows["metric"] == metric]
    return dict(zip(rows["method"], rows["printed"], strict=True))


def printed_number(table: str, metric: str, method: str = "", path: Path = PUBLISHED) -> float:
    """One number that the paper prints, in plain units.

    Args:
        table: As in the transcription, such as `"tab:cmp_bfm"` or `"text:bfm"`.
        metric: Such as `"mse"`.
        method: Of the paper; empty for a number that is of none.
        path: The transcription.

    Raises:
        InputError: There is no such number, or more than one.
    """
    rows = pd.read_csv(path, dtype=str, keep_default_na=False)
    rows = rows[(rows["table"] == table) & (rows["metric"] == metric) & (rows["method"] == method)]
    rows = rows[rows["value"] != ""]
    if len(rows) != 1:
        raise InputError(
            f"{path} must have one number {metric} of {method or 'no method'} in {table}. "
            f"Received {len(rows)}."
        )
    return float(_plain(rows["value"].iloc[0], rows["unit"].iloc[0]))


def unit_of(experiment: str, metric: str) -> float:
    """Power of ten in which the paper prints a metric of an experiment; 1 where it has none.

    Raises:
        InputError: Unknown experiment.
    """
    rows = _rows(experiment, PUBLISHED)
    units = rows["unit"][rows["metric"] == metric]
    return float(_plain("1", units.iloc[0])) if len(units) else 1.0


def as_printed(mean: float, std: float = math.nan) -> list[Decimal]:
    """A number of the paper and its uncertainty, if any, with the digits that are printed.

    Tables hold the paper's numbers as floats, which do not tell 0.3 from 0.30.

    Args:
        mean, std: In plain units, as from `published`; NaN for none.

    Returns:
        In plain units; without trailing zeros where the paper prints no such number.
    """
    numbers = [value for value in (mean, std) if not math.isnan(value)]
    return _printed_digits().get(tuple(numbers)) or [Decimal(f"{value:.6g}") for value in numbers]


@functools.cache
def _printed_digits() -> dict[tuple[float, ...], list[Decimal]]:
    """Numbers of the transcription, with their uncertainties, as they are printed."""
    rows = pd.read_csv(PUBLISHED, dtype=str, keep_default_na=False)
    found = {}
    for row in rows[rows["value"] != ""].itertuples():
        digits = [_plain(text, row.unit) for text in (row.value, row.uncertainty) if text]
        found[tuple(map(float, digits))] = digits
    return found


def _rows(experiment: str, path: Path) -> pd.DataFrame:
    if experiment not in SOURCES:
        raise InputError(
            f"experiment must be one of {', '.join(SOURCES)}. Received {experiment!r}."
        )
    rows = pd.read_csv(path, dtype=str, keep_default_na=False)
    return rows[rows["table"].isin(SOURCES[experiment])]


def _plain(value: str, unit: str) -> Decimal:
    """Decimal, so that 1.4 in units of 1e-4 is 0.00014, not its neighbour, and 0.30 keeps its 0."""
    return Decimal(value or "nan") * (1 if unit in ("", "%") else Decimal(unit))
