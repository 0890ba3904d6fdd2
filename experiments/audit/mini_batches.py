"""Claims on training: mini-batches, the short connection, how many faces, how much is luck."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import ttest_rel

from experiments.audit.evidence import Inputs
from experiments.audit.findings import ALIKE, Finding, does_not_hold, holds, holds_if, unknown
from experiments.methods import DEEP_MDS, title
from experiments.published import published
from experiments.scoring.numbers import enumeration, factor, plus_minus, power

_LEVEL = 0.05  # of the paired test over seeds
_UNIT = 1e-4
# In the order in which they decide: what a user of the method sees last is the shape.
_CRITERIA = {
    "mse": "MSE of the shapes",
    "loss_inference": "loss of the net in use",
    "loss_train": "loss while it trains",
}
_FIVE = "same_face_stable"
_DEPTHS = {
    "two_layers_stable": "two layers",
    "three_layers_stable": "three",
    "five_layers_stable": "five",
    "eight_layers_stable": "eight",
}
_SCHEDULES = {"": "at the paper's constant learning rate", "_stable": "at a decayed one"}


def measure(inputs: Inputs) -> dict:
    """Tables of `make ablation` and `make seeds`; None where they were not run."""
    ablation, seeds = inputs.results("ablation"), inputs.results("seeds")
    curve = inputs.results("ablation", "curves.csv")
    table = published("bfm").set_index(["method", "metric"])
    by_variant = by_seed = None
    if ablation is not None:
        rows = ablation[ablation["faces"] == inputs.run.preset.train_faces]
        by_variant = {
            variant: {
                metric: [*map(float, own["value"])] for metric, own in cells.groupby("metric")
            }
            for variant, cells in rows.sort_values("seed").groupby("variant")
        }
    if seeds is not None:
        rows = seeds[(seeds["metric"] == "mse") & seeds["method"].isin(DEEP_MDS)]
        by_seed = rows.groupby("method")["value"].apply(list).to_dict()
    mse = inputs.scores["ours"].mse
    return {
        "ablation": by_variant,
        "curve": None if curve is None else curve.to_dict("records"),
        "by_seed": by_seed,
        "mse_by_face": {"mean": float(mse.mean()), "std": float(mse.std(ddof=1))},
        "printed_mse": float(table.loc[("ours", "mse"), "paper_mean"]),
        "printed_std": float(table.loc[("ours", "mse"), "paper_std"]),
        "subset_size": inputs.run.preset.subset_size,
    }


def same_face_batches(ablation: Mapping | None) -> Finding:
    """Are mini-batches of one face better than shuffled ones, from the same initial weights?"""
    if ablation is None:
        return unknown("`make ablation`")
    return _compared(ablation, "same_face", "shuffled", "Pairs of one face", "shuffled pairs")


def short_connection(ablation: Mapping | None) -> Finding:
    """Is the net better with the short connection than without?"""
    if ablation is None:
        return unknown("`make ablation`")
    # Trained at the paper's rate only.
    own = {variant: ablation[variant] for variant in ("same_face", "no_short_connection")}
    return _compared(own, "same_face", "no_short_connection", "With it", "without")


def enough_faces(curve: Sequence[Mapping] | None, alike: float = ALIKE) -> Finding:
    """Would fewer training faces have done?"""
    if curve is None:
        return unknown("`make ablation`")
    methods = ("ours_stable", "ours", "linear", "mean_shape")
    errors = {
        method: {int(row["value"]): row["mse"] for row in curve if row["method"] == method}
        for method in methods
    }
    evidence = "MSE by number of training faces: " + "; ".join(
        f"{title(method)} "
        + enumeration([f"{plus_minus(mse, unit=_UNIT)} ({n:,})" for n, mse in own.items()])
        for method, own in errors.items()
    )
    evidence += f", × {power(_UNIT)}. One training each."
    # With a cosine schedule, since chance of the constant one is larger than the effect.
    own = errors["ours_stable"]
    most = max(own)
    enough = [n for n, mse in own.items() if n < most and mse <= alike * own[most]]
    if not enough:
        return holds(
            f"{evidence} With fewer faces the error is more than {alike:g} times as large."
        )
    fewest = min(enough)
    return does_not_hold(
        f"{evidence} With {fewest:,} faces the error is {factor(own[fewest] / own[most])} times "
        f"that with {most:,}, as many steps of training given."
    )


def known_to(
    by_seed: Mapping | None, mse_by_face: Mapping, printed_mse: float, printed_std: float,
    subset_size: int, alike: float = ALIKE,
) -> Finding:  # fmt: skip
    """Does the ± of the table cover what another training gives?"""
    over_subsets = mse_by_face["std"] / subset_size**0.5
    evidence = (
        f"The paper's ± is the spread over samplings of one test set: {printed_std / _UNIT:.3g} of "
        f"{printed_mse / _UNIT:.3g} × {power(_UNIT)}. Errors of faces vary so much here that "
        f"samplings of {subset_size} spread by {plus_minus(over_subsets, unit=_UNIT)}."
    )
    if by_seed is None:
        return unknown("`make seeds`", evidence)
    spreads = {method: np.std(values, ddof=1) for method, values in by_seed.items()}
    evidence += f" From {len(by_seed['ours'])} seeds the MSE is " + enumeration(
        [
            f"{plus_minus(np.mean(values), spreads[method], _UNIT)} ({title(method)}, at worst "
            f"{factor(max(values) / min(values))} times as large as at best)"
            for method, values in by_seed.items()
        ]
    )
    evidence += f", × {power(_UNIT)}."
    if spreads["ours"] <= alike * printed_std:
        return holds(evidence)
    if over_subsets <= alike * printed_std:
        return holds_if("for one trained network", evidence)
    return does_not_hold(evidence)


def five_layers(ablation: Mapping | None) -> Finding:
    """Is the net of five layers more accurate than those of other depths, as large as it may be?"""
    if ablation is None or not {*_DEPTHS} <= {*ablation}:
        return unknown("`make ablation`")
    errors = {variant: np.array(ablation[variant]["mse"]) for variant in (_FIVE, *_DEPTHS)}
    five, p_values = errors.pop(_FIVE), {}
    for variant, own in errors.items():
        p_values[variant] = _p_value(five, own)
    said = enumeration(
        [
            f"{plus_minus(own.mean(), own.std(ddof=1), _UNIT)} for {_DEPTHS[variant]} "
            f"(p = {p_values[variant]:.2g})"
            for variant, own in errors.items()
        ]
    )
    evidence = (
        f"MSE at a decayed rate, mean ± s.d. over {len(five)} seeds, × {power(_UNIT)}: "
        f"{plus_minus(five.mean(), five.std(ddof=1), _UNIT)} for the paper's five layers with a "
        f"short connection. Nets without one are as wide as less than 3,000 trainable parameters "
        f"let them be: {said}. p is of a paired t-test against the paper's."
    )
    worse = [v for v, own in errors.items() if five.mean() < own.mean() and p_values[v] < _LEVEL]
    better = [v for v, own in errors.items() if own.mean() < five.mean() and p_values[v] < _LEVEL]
    if better:
        return does_not_hold(evidence)
    if len(worse) == len(errors):
        return holds(evidence)
    return holds_if("in so far as none is better", evidence)


def _compared(ablation: Mapping, a: str, b: str, first: str, second: str) -> Finding:
    """Is variant `a` better than `b`, in which criteria, at which learning rates?"""
    sentences, better = [], {}
    for suffix, schedule in _SCHEDULES.items():
        if f"{a}{suffix}" not in ablation or f"{b}{suffix}" not in ablation:
            continue
        parts = []
        for metric, name in _CRITERIA.items():
            ours, other = (np.array(ablation[f"{v}{suffix}"][metric]) for v in (a, b))
            p = _p_value(ours, other)
            better[metric, suffix] = p < _LEVEL and ours.mean() < other.mean()
            said = " ± ".join(f"{x / _UNIT:.3g}" for x in (ours.mean(), ours.std(ddof=1)))
            others = " ± ".join(f"{x / _UNIT:.3g}" for x in (other.mean(), other.std(ddof=1)))
            parts.append(f"{name} {said} against {others} (p = {p:.2g})")
        sentences.append(f"{schedule}: {'; '.join(parts)}")
    n = len(ablation[a]["mse"])
    evidence = (
        f"{first} against {second}, mean ± s.d. over {n} seeds, × {power(_UNIT)}, p of a paired "
        f"t-test. {'. '.join(s[0].upper() + s[1:] for s in sentences)}."
    )
    where = [
        f"in the {_CRITERIA[metric]} {_SCHEDULES[suffix]}"
        for (metric, suffix), is_better in better.items()
        if is_better
    ]
    if better["mse", ""]:
        return holds(evidence)
    return holds_if(f"{enumeration(where)} only", evidence) if where else does_not_hold(evidence)


def _p_value(a: np.ndarray, b: np.ndarray) -> float:
    difference = a - b
    if np.ptp(difference) == 0:  # also of one seed: nothing to test
        return 0.0 if len(a) > 1 and difference[0] else 1.0
    return float(ttest_rel(a, b).pvalue)
