"""The verdict below the main table, and the comparison with the committed one."""

import io
import subprocess
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd

from deepmds_keras.errors import InputError
from experiments.methods import CONSTANT, METHODS, title
from experiments.records import git
from experiments.run import Run
from experiments.scoring.numbers import as_quoted, between, plus_minus, power
from experiments.scoring.published import unit_of

# Relative difference that another processor may cause: about the range over ten seeds of Deep-MDS
# with a cosine schedule, which is smaller than at a constant rate.
_TOLERANCE = 0.15
# What orders and claims are judged by.
PROTOCOLS = {"authors": "by the authors' protocol", "faithful": "with faithful baselines"}


def verdict(run: Run) -> list[str]:
    """Lines on the paper's method: its error, the paper's, and those of constant answers."""
    rows, unit = _errors(_fresh(run)), unit_of(run.track, "mse")
    ours, constant, mean = (
        _cell(rows, method, unit) for method in ("deep_mds", CONSTANT, "mean_shape")
    )
    paper = as_quoted(*rows.loc["deep_mds", ["paper_mean", "paper_std"]], unit)
    lines = [
        f"MSE in {power(unit)}: Deep-MDS {ours} (paper {paper}); one output of its own for all "
        f"views {constant}; the mean shape {mean}."
    ]
    lines += order_lines(rows)
    if run.preset.caution:
        return [*lines, f"Not compared with the committed run: {run.preset.caution}."]
    committed = _committed(run)
    if committed is None:
        return [*lines, "There is no committed run to compare with."]
    there = _errors(committed)
    if "median" in there and "median" not in rows:
        lines.append(
            f"These numbers are of seed {run.seed} alone. The committed table, and the pages, have "
            f"the median over {there['n_seeds'].max():.0f} seeds: Deep-MDS "
            f"{_cell(there, 'deep_mds', unit)} (make reproduce-{run.track} "
            f"SEEDS={there['n_seeds'].max():.0f})."
        )
    off = _differences(rows, there)
    if off.empty:
        return [*lines, f"This run agrees with the committed one{_not_compared(rows, there)}."]
    return [*lines, f"It differs from the committed run, see make check: {', '.join(off.index)}."]


@dataclass(frozen=True)
class Order:
    """The order of the paper's methods by MSE, as a table has it.

    Attributes:
        protocol: In words.
        methods: Ids, the least error first.
        same, pairs: Of so many pairs of methods, those that the paper has in the same order.
    """

    protocol: str
    methods: list[str]
    same: int
    pairs: int

    @property
    def verdict(self) -> str:
        if self.same in (0, self.pairs):
            found = "reproduced" if self.same else "not reproduced"
        else:
            found = "partly reproduced"
        return f"{found} ({self.same} of {self.pairs} pairs)"


def orders(rows: pd.DataFrame) -> list[Order]:
    """Whether the paper's order is found again by its authors' protocol, and by a fair one.

    Args:
        rows: Rows of a table with the MSE, by method. Those with a number of the paper are made as
            the authors made it as far as their code shows: not Zhao's net on photos, nor the
            training of MobileFace. `Method.fair` names what to compare instead.
    """
    here = rows["median"].fillna(rows["mean"]) if "median" in rows else rows["mean"]
    published = rows["paper_mean"].drop(CONSTANT, errors="ignore").dropna()
    protocols = {
        PROTOCOLS["authors"]: {method: method for method in published.index},
        PROTOCOLS["faithful"]: {m: METHODS[m].fair or m for m in published.index},
    }
    found = []
    for protocol, rows_of in protocols.items():
        errors = pd.Series({m: here.get(row, np.nan) for m, row in rows_of.items()}).dropna()
        pairs = [*combinations(errors.index, 2)]
        same = sum((errors[a] < errors[b]) == (published[a] < published[b]) for a, b in pairs)
        methods = [rows_of[method] for method in errors.sort_values().index]
        found.append(Order(protocol, methods, same, len(pairs)))
    return [order for order in found if order.pairs]


def order_lines(rows: pd.DataFrame) -> list[str]:
    """`orders` as sentences."""
    lines = [
        f"Order of the paper's methods by MSE, {order.protocol}: {order.verdict}: "
        f"{' < '.join(map(title, order.methods)).removesuffix('.')}."
        for order in orders(rows)
    ]
    if lines and "median" not in rows:
        lines[-1] += " One training of each: indicative."
    return lines


def _differences(here: pd.DataFrame, there: pd.DataFrame) -> pd.DataFrame:
    """Methods whose error differs from the committed one.

    Returns:
        `here, low, high` by method: the error, and the range that the committed run allows: that of
        its seeds or, for one training, its error, widened by `_TOLERANCE`.
    """
    ends = there.reindex(columns=["lowest", "highest"])
    allowed = pd.DataFrame(
        {
            "here": here["mean"],
            "low": (1 - _TOLERANCE) * ends["lowest"].fillna(there["mean"]),
            "high": (1 + _TOLERANCE) * ends["highest"].fillna(there["mean"]),
        }
    ).dropna()
    return allowed[~allowed["here"].between(allowed["low"], allowed["high"])]


def _not_compared(here: pd.DataFrame, there: pd.DataFrame) -> str:
    """End of a sentence with the methods of the committed run that this one was without."""
    without = there.index[there["mean"].notna() & here["mean"].reindex(there.index).isna()]
    return f"; not run here: {', '.join(without)}" if len(without) else ""


def check(run: Run) -> None:
    """Report whether the table of a run matches the committed one; exit with status 1 if not.

    Raises:
        InputError: One of the two does not exist, they are the same file, or the run is small.
    """
    if run.preset.caution:
        raise InputError(
            "PRESET must be full: no table of another size is committed for comparison. Received "
            f"{run.preset.name}."
        )
    fresh, committed = _fresh(run), _committed(run)
    if committed is None:
        raise InputError(f"{_table(run)} not found in git's last commit.")
    if fresh == committed:  # times and all
        raise InputError(
            f"{_table(run)} must come from your own run. Received the committed one: run "
            f"make reproduce-{run.track} first."
        )
    here, there = _errors(fresh), _errors(committed)
    off = _differences(here, there)
    if len(off):
        print(off.to_string(float_format="{:.3g}".format))
        raise SystemExit(1)
    print(f"{_table(run)} agrees with the committed run{_not_compared(here, there)}.")


def _cell(rows: pd.DataFrame, method: str, unit: float) -> str:
    if method not in rows.index:
        return "not run"
    row = rows.loc[method].reindex(["mean", "std", "median", "lowest", "highest"])
    if np.isnan(row["median"]):
        return plus_minus(row["mean"], row["std"], unit)
    return between(row["median"], row["lowest"], row["highest"], unit)


def _table(run: Run) -> Path:
    return run.experiment_results(run.evaluation) / "table.csv"


def _fresh(run: Run) -> str:
    if not _table(run).is_file():
        raise InputError(f"{_table(run)} not found: run make reproduce-{run.track} first.")
    return _table(run).read_text(encoding="utf-8").strip()


def _committed(run: Run) -> str | None:
    path = _table(run)
    try:
        return git("show", f"HEAD:./{path.name}", folder=path.parent)
    except (OSError, subprocess.CalledProcessError):
        return None


def _errors(text: str) -> pd.DataFrame:
    """Rows of a table with the MSE, by method."""
    table = pd.read_csv(io.StringIO(text))
    return table[table["metric"] == "mse"].set_index("method")
