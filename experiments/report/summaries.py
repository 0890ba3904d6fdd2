"""Two sentences on each experiment, from its numbers."""

from __future__ import annotations

import pandas as pd

from experiments.methods import DEEP_MDS, METHODS, title
from experiments.report.experiment import Experiment
from experiments.scoring.numbers import (
    NOTHING,
    as_quoted,
    between,
    enumeration,
    factor,
    plus_minus,
    power,
)

_OURS, _CONSTANT, _PERFECT = "ours", "mean_shape", "zhao_true_depth"
_SAME_METHOD = tuple(method.id for method in METHODS.values() if method.deep_mds)
_EASIER_VIEWS = ("zhao_frontal",)


def methods_of(rows: pd.DataFrame) -> list[str]:
    """Of rows by method those of methods; others say how far apart two truths are, or the like."""
    said = rows["note"].fillna("") + "; " + rows.index.map(lambda m: METHODS[m].description)
    return [*rows.index[~said.str.contains(r"(?:^|; )no method")]]


def measured(experiment: Experiment, metric: str = "mse") -> pd.DataFrame:
    """Rows of a metric by method, of those that have a number of ours.

    Where a method was trained from several seeds, its `mean` is the median over them.
    """
    table = experiment.table()
    rows = table[(table["metric"] == metric) & table["mean"].notna()].set_index("method")
    return rows.assign(mean=rows["median"].fillna(rows["mean"])) if "n_seeds" in rows else rows


def better_than_ours(mse: pd.DataFrame) -> tuple[list[str], list[str]]:
    """Other methods with a smaller error than the paper's method, and all the others."""
    left_out = (*_SAME_METHOD, *_EASIER_VIEWS)
    others = [method for method in methods_of(mse) if method not in left_out]
    ordered = mse.loc[others, "mean"].sort_values()
    return [*ordered.index[ordered < mse.loc[_OURS, "mean"]]], others


def summary(experiment: Experiment, others: list[Experiment]) -> str:
    """Findings of an experiment in words, for better or worse; empty for an unknown one.

    Args:
        experiment: Of which to speak.
        others: All of the report, of which some are compared with.
    """
    if experiment.has("claims.csv"):
        return ""  # its tables begin with it
    if experiment.base == "parameters":
        return _of_parameters(experiment)
    if experiment.base == "seeds":
        return _of_seeds(experiment)
    if not experiment.compared or _OURS not in (mse := measured(experiment)).index:
        return ""
    if experiment.base == "bfm-evaluator-released":
        beside = [o for o in others if (o.base, o.variant) == ("bfm", experiment.variant)]
        return _of_released_evaluator(experiment, mse, beside[0] if beside else None)
    return f"{_against_the_paper(experiment, mse)} {_against_the_others(experiment, mse)}"


def _against_the_paper(experiment: Experiment, mse: pd.DataFrame) -> str:
    ours, unit = mse.loc[_OURS], experiment.mse_unit
    sentence = f"{title(_OURS)} has an MSE of {error(ours, unit)}"
    if pd.isna(ours["paper_mean"]):
        return f"{sentence}; the paper prints none."
    ratio = factor(ours["mean"] / ours["paper_mean"])
    return f"{sentence}, {ratio} times the {printed(ours, unit)} that the paper prints."


def _against_the_others(experiment: Experiment, mse: pd.DataFrame) -> str:
    better, others = better_than_ours(mse)
    if not others:
        return "No other method was run."
    ratios = mse["mean"] / mse.loc[_OURS, "mean"]
    have = "has" if len(better) == 1 else "have"
    count = f"{len(better) or 'None'} of the {len(others)} other methods"
    sentence = f"{count} on the same faces {have} a smaller error"
    if better:
        listing = enumeration([f"{title(m)} {factor(ratios[m])}" for m in better])
        sentence += f": {listing} times it"
    if _CONSTANT in others and _CONSTANT not in better:
        sentence += f". One constant shape has {factor(ratios[_CONSTANT])} times it"
    return f"{sentence}.{_of_the_truth(ratios, methods_of(mse))}"


def _of_the_truth(ratios: pd.Series, methods: list[str]) -> str:
    """Distance between two ground truths, and the methods that err no more than that."""
    truths = [row for row in ratios.index if row not in methods]
    if not truths:
        return ""
    row = ratios[truths].idxmax()
    within = [method for method in methods if ratios[method] <= ratios[row]]
    return (
        f' The row "{title(row)}" is no method: it is how far apart two truths are. It has '
        f"{factor(ratios[row])} times the error of {title(_OURS)}; "
        f"{enumeration([*map(title, within)]) or 'no method'} no more."
    )


def _of_released_evaluator(
    experiment: Experiment, mse: pd.DataFrame, beside: Experiment | None
) -> str:
    unit, quoted = experiment.mse_unit, mse[mse["paper_mean"].notna()]
    nets = [method for method in quoted.index if method.startswith("zhao")]
    if _PERFECT not in mse.index or not nets:
        return f"{_against_the_paper(experiment, mse)} {_against_the_others(experiment, mse)}"
    net, perfect = mse.loc[nets[0]], mse.loc[_PERFECT]
    first = (
        "Scored as the authors' script scores Zhao's net, the true depth itself has an MSE of "
        f"{error(perfect, unit)}. That is {factor(perfect['mean'] / net['paper_mean'])} times the "
        f"{printed(net, unit)} that the paper prints for that net."
    )
    second = f'The net (row "{title(nets[0])}") has {error(net, unit)}'
    if beside is not None and nets[0] in (fair := measured(beside)).index:
        ratio = factor(net["mean"] / fair.loc[nets[0], "mean"])
        second += f", {ratio} times the error that it has when scored like every other method"
    return f"{first} {second}."


def _of_seeds(experiment: Experiment) -> str:
    table = experiment.table().set_index(["method", "metric"])
    unit = experiment.mse_unit
    ranges, lags = [], []
    methods = dict.fromkeys(table.index.get_level_values("method"))
    for method in [method for method in methods if method in DEEP_MDS]:
        mse = table.loc[(method, "mse")]
        low, high = (plus_minus(mse[end], unit=unit) for end in ("min", "max"))
        ratio = factor(mse["max"] / mse["min"])
        ranges.append(f"{low} to {high} × {power(unit)} ({ratio} times) for {title(method)}")
        moving, anew = (
            table.loc[(method, f"autoencoder_mse_{statistics}"), "median"]
            for statistics in ("inference", "reestimated")
        )
        lags.append(f"{factor(moving / anew)} for {title(method)}")
    return (
        f"Over {int(table['count'].max())} seeds the MSE is {enumeration(ranges)}. The "
        "autoencoder's median error is larger with the moving statistics of batch normalisation "
        "than with statistics estimated anew for the same weights. The ratio is "
        f"{enumeration(lags)}."
    )


def _of_parameters(experiment: Experiment) -> str:
    table = experiment.table().set_index("method")
    ours, known = table.loc[_OURS], table["trainable"].dropna()
    theirs = f"{int(ours['paper']):,}" if ours["paper"].isdigit() else ours["paper"]
    most = known.idxmax()
    first = (
        f"{title(_OURS)} has {ours['trainable']:,.0f} trainable parameters where the paper prints "
        f"{theirs}; {title(most)} has the most, {known[most]:,.0f}."
    )
    others = table[~table.index.isin(_SAME_METHOD)]
    timed = others["ms_per_face"].dropna()
    if not len(timed) or pd.isna(ours["ms_per_face"]):
        return first
    slower = [title(method) for method in timed.index[timed > ours["ms_per_face"]]]
    return (
        f"{first} It takes {ours['ms_per_face']:.3g} ms per face, more than "
        f"{len(timed) - len(slower)} of the {len(timed)} other methods timed here"
        f"{f'; {enumeration(slower)} take more' if slower else ''}."
    )


def error(row: pd.Series, unit: float) -> str:
    """An error of ours in a power of ten: mean and s.d., or over seeds the median and the range."""
    if row.get("n_seeds", 0) > 1:
        over_seeds = between(row["median"], row["lowest"], row["highest"], unit)
        return f"{_in_unit(over_seeds, unit)} over {row['n_seeds']:.0f} seeds"
    return _in_unit(plus_minus(row["mean"], row["std"], unit), unit)


def printed(row: pd.Series, unit: float) -> str:
    """The paper's number in its place, if there is one."""
    return _in_unit(as_quoted(row["paper_mean"], row["paper_std"], unit), unit)


def _in_unit(number: str, unit: float) -> str:
    return number if number == NOTHING else f"({number}) × {power(unit)}"
