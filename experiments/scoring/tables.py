"""From `metrics.csv` to the files of an experiment: `table.csv`, `table.tex`, `wilcoxon.csv`."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.methods import METHODS, rows_of_paper, title
from experiments.records import (
    MANIFEST,
    commits_of,
    environment,
    read_manifest,
    write_csv,
    write_text,
)
from experiments.run import Run
from experiments.scoring.metrics import METRICS, metrics_of
from experiments.scoring.published import published
from experiments.scoring.typesetting import latex, text
from experiments.scoring.verdict import verdict

_KEYS = ["method", "metric"]
_PAPER = ["paper_mean", "paper_std"]
_SEEDS = ["n_seeds", "median", "lowest", "highest"]
# What the paper uses as the truth, if a substitute knows a better one.
_TRUTHS = {
    "flame": "the landmarks found on the scans, as in the paper",
    "celeba": "the model fitted to the photos, as in the paper",
}


def summarise(
    metrics: pd.DataFrame,
    experiment: str,
    notes: Mapping[str, str],
    *,
    subset_size: int,
    n_landmarks: int,
    paper_rows: Mapping[str, str] = {},
    seeds: pd.DataFrame | None = None,
) -> pd.DataFrame:
    """Mean and standard deviation over subsets of every method and metric, next to the paper's.

    Args:
        metrics: `method`, `metric`, `subset` (empty if a number belongs to none), `value`.
        experiment: `"bfm"`, `"celeba"` or `"flame"`: the paper's table to compare with.
        notes: Method → what a reader must know about it; for one that was not run, why not.
        subset_size: Test faces in a subset.
        n_landmarks: Of a face.
        paper_rows: Method of the paper → the method with which its numbers are compared, if
            different from `METHODS`.
        seeds: `method`, `metric`, `seed`, `value` over all test faces of each seed, for methods
            trained from several.

    Returns:
        `method, metric, mean, std, paper_mean, paper_std, n_subsets, subset_size, n_landmarks,
        note`, and with seeds `n_seeds, median, lowest, highest`, with a row for every method
        (measured, quoted or noted) and metric. A cell that was not measured is empty and its `note`
        says why. `std` is that of a sample (n - 1). Notes of a cell are separated by `"; "`.

    Raises:
        InputError: A method is unknown.
    """
    metrics, quoted = _with_derived(metrics), published(experiment)
    measured = metrics.groupby(_KEYS)["value"].agg(mean="mean", std="std", n_subsets="count")
    # Numbers that are measured once, such as a time, have no subset.
    measured["n_subsets"] = metrics.groupby(_KEYS)["subset"].count()
    rows = rows_of_paper(paper_rows)
    quoted = quoted.assign(method=quoted["method"].map(rows)).set_index(_KEYS)
    present = {*metrics["method"], *quoted.index.get_level_values("method"), *notes}
    for method in sorted(present):
        title(method)  # refuses an unknown one
    methods = [method for method in METHODS if method in present]
    columns = [metric.id for metric in metrics_of(experiment)]
    cells = pd.MultiIndex.from_product([methods, columns], names=_KEYS)
    table = measured.reindex(cells).join(quoted)
    table["n_subsets"] = table["n_subsets"].replace(0, np.nan).astype("Int64")
    table["subset_size"] = table["n_subsets"].where(table["n_subsets"].isna(), subset_size)
    run = {*metrics["method"]}
    table["note"] = [
        _note(metric, row, method in run, notes.get(method))
        for (method, metric), row in table.iterrows()
    ]
    table["n_landmarks"] = n_landmarks
    sizes = ("n_subsets", "subset_size", "n_landmarks")
    table = table[["mean", "std", *_PAPER, *sizes, "note"]].reset_index()
    return table if seeds is None else table.join(_over_seeds(seeds), on=_KEYS)


def write_tables(
    folder: Path,
    metrics: pd.DataFrame,
    *,
    experiment: str,
    per_face: Mapping[str, Mapping[str, np.ndarray]],
    over_all: str = "faces",
    seeds: pd.DataFrame | None = None,
    **options,
) -> pd.DataFrame:
    """Write `table.csv`, `table.tex` and `wilcoxon.csv`.

    Args:
        folder: `results/<model>/<experiment>`.
        metrics, experiment, seeds, options: As for `summarise`.
        per_face: Metric → method → `(n,)`, for all test faces in one order.
        over_all: What `per_face` has a value of: `"faces"`, or `"subjects"` of several faces each.

    Returns:
        The content of `table.csv`.
    """
    table = summarise(metrics, experiment, seeds=seeds, **options)
    write_csv(folder / "table.csv", table)
    write_text(folder / "table.tex", latex(table, experiment))
    write_csv(folder / "wilcoxon.csv", wilcoxon_tests(metrics, per_face, seeds, over_all))
    return table


def wilcoxon_tests(
    metrics: pd.DataFrame,
    per_face: Mapping[str, Mapping[str, np.ndarray]],
    seeds: pd.DataFrame | None = None,
    over_all: str = "faces",
) -> pd.DataFrame:
    """Wilcoxon tests over trainings from several seeds, over subsets, and over all test faces.

    Only the first can distinguish methods: they are paired by seed, and `p_holm` is corrected for
    the number of pairs of methods. Subsets, as in the paper, differ by resampling alone, and both
    they and the faces come from one training. Scans of one subject are not independent: where
    there are several, `over_all` is `"subjects"`.
    """
    # Here, since scipy.stats takes a while to import.
    from experiments.scoring.intervals import holm_adjusted
    from experiments.scoring.wilcoxon import wilcoxon_table

    samples, tables = [], {"subsets": metrics.dropna(subset="subset"), "seeds": seeds}
    for metric in (metric.id for metric in METRICS.values() if metric.in_paper):
        for over, table in tables.items():
            if table is not None:
                rows = table[table["metric"] == metric]
                values = rows.pivot(index=over.removesuffix("s"), columns="method", values="value")
                methods = [method for method in METHODS if method in values]
                samples.append((over, metric, {m: values[m].to_numpy() for m in methods}))
    samples += [(over_all, metric, dict(values)) for metric, values in per_face.items()]
    tests = []
    for over, metric, values in samples:
        names = pd.DataFrame({"over": [over], "metric": [metric]})
        table = wilcoxon_table(values)
        table["p_holm"] = holm_adjusted(table["p_value"]) if over == "seeds" else np.nan
        tests.append(names.merge(table, how="cross"))
    return pd.concat([test for test in tests if len(test)] or tests[:1], ignore_index=True)


def print_tables(run: Run) -> None:
    """Print the tables that a run of a track has written, and their folders.

    Raises:
        InputError: There are none.
    """
    written = []
    for name in (run.evaluation, f"{run.track}-true-landmarks"):
        path = run.experiment_results(name) / "table.csv"
        if not path.is_file():
            continue
        truth = _TRUTHS.get(name, "the true landmarks, which the substitute knows")
        against = f", against {truth}" if run.track in _TRUTHS else ""
        print(f"\n{run.model}, {run.preset.name} preset, seed {run.seed}{against}\n")
        print(text(pd.read_csv(path), run.track))
        written.append(path.parent)
    for folder in written:
        print(f"Tables, figures and manifest: {folder}/")
        if (folder / MANIFEST).is_file():
            _print_commit(folder)
    print(*verdict(run), sep="\n")


def _print_commit(folder: Path) -> None:
    """Say by which code a folder's results were made, if it is not that of now."""
    made, now = commits_of(read_manifest(folder)), environment()["commit"]
    if now and made != {now}:
        print(
            f"They were made at commit {', '.join(sorted(made)) or 'unknown'}; HEAD is {now}. What "
            "is done is not done again, whatever has changed in the code: delete build/ for that."
        )


def _over_seeds(seeds: pd.DataFrame) -> pd.DataFrame:
    statistics = seeds.groupby(_KEYS)["value"].agg(["count", "median", "min", "max"])
    return statistics.set_axis(_SEEDS, axis=1).astype({"n_seeds": "Int64"})


def _with_derived(metrics: pd.DataFrame) -> pd.DataFrame:
    tables = [metrics]
    for metric in METRICS.values():
        if metric.derived:
            source, function = metric.derived
            rows = metrics[metrics["metric"] == source]
            tables.append(rows.assign(metric=metric.id, value=function(rows["value"])))
    return pd.concat(tables, ignore_index=True)


def _note(metric: str, row: pd.Series, was_run: bool, note: str | None) -> str:
    """Notes on a cell: on the method, or why there is no number; and on the paper's number."""
    reason = note or ("" if was_run else "not part of this experiment")
    if was_run and pd.isna(row["mean"]):
        reason = f"{metric} not measured"
    of_paper = row["paper_note"] if isinstance(row["paper_note"], str) else ""
    parts = [f"in the paper, {part}" for part in of_paper.split("; ") if part]
    return "; ".join([reason, *parts] if reason else parts)
