"""The numbers that the paper prints, from `results/published/published.csv`."""

import functools
import math
from decimal import Decimal

import pandas as pd

from experiments.records import PUBLISHED

_FILE = PUBLISHED / "published.csv"

# The paper's table of an experiment, and where else its text gives a number for it.
SOURCES = {
    "bfm": ("tab:cmp_bfm", "text:bfm"),
    "celeba": ("tab:cmp_celebA_bfm",),
    "flame": ("tab:cmp_casia", "text:casia"),
    "parameters": ("tab:cmp_param",),
}


def published(experiment: str) -> pd.DataFrame:
    """The paper's numbers for an experiment of `SOURCES`, in plain units.

    Returns:
        A row for each method and metric: `method`, `metric`, `paper_mean`, `paper_std` (NaN where
        none is printed) and `paper_note`. 1.4 in units of 1e-4 is 1.4e-4; depth correlations stay
        as printed, since the paper's "%" is a sum over landmarks.
    """
    rows = _rows(experiment)
    rows = rows[(rows["method"] != "") & (rows["value"] != "")].reset_index(drop=True)
    numbers = [(*map(float, digits), math.nan)[:2] for digits in rows["digits"]]
    numbers = pd.DataFrame(numbers, columns=["paper_mean", "paper_std"])
    notes = rows["note"].rename("paper_note")
    return pd.concat([rows[["method", "metric"]], numbers, notes], axis=1)


def published_mse(method: str) -> float:
    """What the paper prints as the error of a method on the BFM, in plain units."""
    errors = published("bfm").query("metric == 'mse'").set_index("method")
    return errors["paper_mean"][method]


def paper_table(experiment: str) -> pd.DataFrame:
    """Cells of the paper's own table: `table, row, column, method, metric, printed`."""
    rows = _rows(experiment)
    return rows[rows["table"].str.startswith("tab:") & rows["method"].ne("")]


def printed(experiment: str, metric: str) -> dict[str, str]:
    """Cells of a metric as the paper prints them, by method, even those that are no numbers."""
    rows = _rows(experiment)
    rows = rows[rows["metric"] == metric]
    return dict(zip(rows["method"], rows["printed"], strict=True))


def unit_of(experiment: str, metric: str) -> float:
    """Power of ten in which the paper prints a metric of an experiment; 1 if it has none."""
    rows = _rows(experiment)
    units = rows["unit"][rows["metric"] == metric]
    return float(_plain("1", units.iloc[0])) if len(units) else 1.0


def as_printed(mean: float, std: float = math.nan) -> list[Decimal]:
    """A number of the paper and its uncertainty, if not NaN, with the printed digits; plain units.

    Tables hold the paper's numbers as floats, which do not distinguish 0.3 from 0.30. A number that
    the paper does not print has no trailing zeros.
    """
    numbers = tuple(value for value in (mean, std) if not math.isnan(value))
    printed = {tuple(map(float, digits)): digits for digits in _transcription()["digits"]}
    return printed.get(numbers) or [Decimal(f"{value:.6g}") for value in numbers]


@functools.cache
def _transcription() -> pd.DataFrame:
    """The paper's numbers; `digits` are a number and its uncertainty, if any, in plain units."""
    rows = pd.read_csv(_FILE, dtype=str, keep_default_na=False)
    rows["digits"] = [
        [_plain(text, row.unit) for text in (row.value, row.uncertainty) if text]
        for row in rows.itertuples()
    ]
    return rows


def _rows(experiment: str) -> pd.DataFrame:
    rows = _transcription()
    return rows[rows["table"].isin(SOURCES[experiment])]


def _plain(value: str, unit: str) -> Decimal:
    """Decimal, so that 1.4 in units of 1e-4 is 0.00014, not its neighbour, and 0.30 keeps its 0."""
    return Decimal(value) * (1 if unit in ("", "%") else Decimal(unit))
