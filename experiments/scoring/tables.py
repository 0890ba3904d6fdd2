"""From `metrics.csv` to the files of an experiment: `table.csv`, `table.tex`, `wilcoxon.csv`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from deepmds_keras.io.errors import InputError
from deepmds_keras.metrics import wilcoxon_table
from experiments.methods import METHODS, title
from experiments.metrics import METRICS, metrics_of
from experiments.published import published
from experiments.records import write_text
from experiments.scoring.typesetting import latex

COLUMNS = (
    "method",
    "metric",
    "mean",
    "std",
    "paper_mean",
    "paper_std",
    "n_subsets",
    "subset_size",
    "note",
)
SEED_COLUMNS = ("n_seeds", "median", "lowest", "highest")


def summarise(
    metrics: pd.DataFrame,
    experiment: str,
    notes: Mapping[str, str],
    *,
    subset_size: int,
    beside: Mapping[str, str] = {},
    seeds: pd.DataFrame | None = None,
) -> pd.DataFrame:
    """Mean and standard deviation over subsets of every method and metric, beside the paper's.

    Args:
        metrics: `method`, `metric`, `subset` (empty where a number is of no subset), `value`.
        experiment: `"bfm"`, `"celeba"` or `"flame"`: which of the paper's tables it stands beside.
        notes: Method to what a reader must know of it; for one that was not run, why not.
        subset_size: Test faces in a subset.
        beside: Method of the paper to the one that its numbers stand beside, where that is another
            than `METHODS` says.
        seeds: `method`, `metric`, `seed`, `value` over all test faces of each seed, of methods that
            were trained from several.

    Returns:
        `COLUMNS`, and with seeds `SEED_COLUMNS`, with a row for every method (measured, quoted or
        noted) and metric. A cell that was not measured is empty and its `note` says why. `std` is
        that of a sample (n - 1). Notes of a cell are separated by `"; "`.

    Raises:
        InputError: A column is missing, a row is there twice, or the experiment, a method or a
            metric is unknown.
    """
    metrics, quoted = _with_derived(_checked(metrics)), published(experiment)
    grouped = metrics.groupby(["method", "metric"])
    measured = grouped.agg(
        mean=("value", "mean"), std=("value", "std"), n_subsets=("subset", "count")
    )
    ours = {method.paper: method.id for method in METHODS.values() if method.paper} | dict(beside)
    quoted = quoted.assign(method=quoted["method"].map(ours)).set_index(["method", "metric"])
    present = {*metrics["method"], *quoted.index.get_level_values("method"), *notes}
    for method in sorted(present):
        title(method)
    columns = [metric.id for metric in metrics_of(experiment)]
    cells = pd.MultiIndex.from_product(
        [[method for method in METHODS if method in present], columns],
        names=["method", "metric"],
    )
    table = measured.reindex(cells).join(quoted)
    table["n_subsets"] = table["n_subsets"].replace(0, np.nan).astype("Int64")
    table["subset_size"] = pd.Series(subset_size, table.index, "Int64").where(
        table["n_subsets"].notna()
    )
    run = {*metrics["method"]}
    table["note"] = [
        _note(method, metric, row, method in run, notes.get(method))
        for (method, metric), row in table.iterrows()
    ]
    table = table.reset_index()[[*COLUMNS]]
    return table if seeds is None else table.join(_over_seeds(seeds), on=["method", "metric"])


def write_tables(
    folder: Path,
    metrics: pd.DataFrame,
    *,
    experiment: str,
    subset_size: int,
    notes: Mapping[str, str],
    per_face: Mapping[str, Mapping[str, np.ndarray]],
    beside: Mapping[str, str] = {},
    seeds: pd.DataFrame | None = None,
) -> pd.DataFrame:
    """Write `table.csv`, `table.tex` and `wilcoxon.csv`.

    Args:
        folder: `results/<model>/<experiment>`.
        metrics, experiment, subset_size, notes, beside, seeds: As for `summarise`.
        per_face: Metric to method to `(n,)`, of all test faces in one order.

    Returns:
        What `table.csv` holds.
    """
    table = summarise(
        metrics, experiment, notes, subset_size=subset_size, beside=beside, seeds=seeds
    )
    write_csv(folder / "table.csv", table)
    write_text(folder / "table.tex", latex(table, experiment))
    write_csv(folder / "wilcoxon.csv", wilcoxon_tests(metrics, per_face))
    return table


def wilcoxon_tests(
    metrics: pd.DataFrame, per_face: Mapping[str, Mapping[str, np.ndarray]]
) -> pd.DataFrame:
    """Wilcoxon tests over the subsets, the paper's way, and over all faces.

    Subsets of one test set differ only by resampling, so the first says little of the methods.
    """
    tests = []
    for metric in (metric.id for metric in METRICS.values() if metric.in_paper):
        rows = metrics[(metrics["metric"] == metric) & metrics["subset"].notna()]
        subsets = rows.pivot(index="subset", columns="method", values="value")
        subsets = subsets[[method for method in METHODS if method in subsets]]
        tests.append(("subsets", metric, {m: subsets[m].to_numpy() for m in subsets}))
    tests += [("faces", metric, dict(values)) for metric, values in per_face.items()]
    frames = []
    for over, metric, values in tests:
        frame = wilcoxon_table(values)
        frame.insert(0, "over", over)
        frame.insert(1, "metric", metric)
        frames.append(frame)
    return pd.concat([f for f in frames if len(f)] or frames[:1], ignore_index=True)


def write_csv(path: Path, table: pd.DataFrame) -> None:
    """Write CSV with eight significant digits, alike on every system."""
    text = table.to_csv(index=False, float_format="%.8g", lineterminator="\n")
    write_text(path, text)


def _over_seeds(seeds: pd.DataFrame) -> pd.DataFrame:
    found = seeds.groupby(["method", "metric"])["value"].agg(["count", "median", "min", "max"])
    found.columns = [*SEED_COLUMNS]
    return found.astype({"n_seeds": "Int64"})


def _checked(metrics: pd.DataFrame) -> pd.DataFrame:
    missing = {"method", "metric", "subset", "value"} - {*metrics.columns}
    if missing:
        raise InputError(
            "metrics must have columns method, metric, subset, value. "
            f"Received {', '.join(metrics.columns)}."
        )
    twice = metrics[metrics.duplicated(["method", "metric", "subset"])]
    if len(twice):
        raise InputError(
            "metrics must have one row for each method, metric and subset. "
            f"Received {', '.join(map(str, twice.iloc[0, :3]))} twice."
        )
    unknown = [metric for metric in metrics["metric"] if metric not in METRICS]
    if unknown:
        raise InputError(f"metric must be one of {', '.join(METRICS)}. Received {unknown[0]!r}.")
    return metrics


def _with_derived(metrics: pd.DataFrame) -> pd.DataFrame:
    frames = [metrics]
    for metric in METRICS.values():
        if metric.derived:
            source, function = metric.derived
            rows = metrics[metrics["metric"] == source]
            frames.append(rows.assign(metric=metric.id, value=function(rows["value"])))
    return pd.concat(frames, ignore_index=True)


def _note(method: str, metric: str, row: pd.Series, was_run: bool, note: str | None) -> str:
    if not was_run:
        reason = note or "not part of this experiment"
    elif math.isnan(row["mean"]):
        reason = f"{metric} not measured"
    else:
        reason = note
    remark = row["paper_note"] if isinstance(row["paper_note"], str) else ""
    of_paper = [f"in the paper, {part}" for part in remark.split("; ") if part]
    return "; ".join([reason, *of_paper] if reason else of_paper)
