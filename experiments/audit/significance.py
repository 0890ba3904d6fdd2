"""Claims on the paper's p-value, and on samplings of one test set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from scipy.stats import norm, rankdata, wilcoxon

from deepmds_keras.metrics import wilcoxon_table
from experiments.audit.claims import load_claims
from experiments.audit.evidence import Inputs
from experiments.audit.findings import Finding, does_not_hold, holds, holds_if
from experiments.published import printed_number
from experiments.scoring.numbers import enumeration, scientific
from experiments.streams import Stream

_PAPER = ("zhao", "aldrian", "mobileface", "ours")
_CASIA = ("zhao", "ringnet", "mediapipe", "ours")
_NUMBERS = range(5, 31)  # of differences, for which the least p-value is computed
_SIMULATIONS = 500
_MORE_SAMPLINGS = (20, 50)
# A test that finds a difference where there is none more than twice as often as its level allows
# is no test at that level.
TOO_OFTEN = 2.0


def measure(inputs: Inputs) -> dict:
    """Least p-values, and how often samplings tell exchangeable methods apart."""
    preset, claims = inputs.run.preset, load_claims()
    level = claims["significance"].numbers["level"]
    errors = {method: inputs.scores[method].mse for method in ("ours", "ours_stable")}
    samplings = sorted({preset.n_subsets, *_MORE_SAMPLINGS})
    return {
        "p_values": {str(n): least_p_value(n) for n in _NUMBERS},
        "printed_p": printed_number("text:bfm", "wilcoxon_p_value"),
        "printed_p_casia": printed_number("text:casia", "wilcoxon_p_value"),
        "criteria": _printed_criteria("tab:cmp_bfm", _PAPER),
        "criteria_casia": _printed_criteria("tab:cmp_casia", _CASIA),
        "sampled": {"samplings": preset.n_subsets, "faces": preset.subset_size},
        "n_faces": len(errors["ours"]),
        "false_positives": false_positives(
            errors["ours"] - errors["ours_stable"],
            samplings,
            preset.subset_size,
            level,
            np.random.default_rng([inputs.run.seed, Stream.AUDIT_SIGNIFICANCE]),
        ),
        "pairs": over_faces({m: inputs.scores[m].mse for m in _PAPER if m in inputs.scores}, level),
    }


def _printed_criteria(table: str, methods: Sequence[str]) -> dict[str, float]:
    printed = {
        method: [printed_number(table, metric, method) for metric in ("mse", "depth_corr")]
        for method in methods
    }
    return both_criteria(printed, round(load_claims()["p-value"].numbers["n_subsets"]))


def least_p_value(n: int) -> dict[str, float]:
    """Wilcoxon p-value, two-sided, of n different differences of one sign: `exact`, `normal`."""
    test = wilcoxon_table({"a": np.arange(1.0, n + 1), "b": np.zeros(n)}).iloc[0]
    return {"exact": float(test.p_value), "normal": float(test.p_value_normal)}


def both_criteria(printed: Mapping[str, list[float]], n: int) -> dict[str, float]:
    """P-values that the samplings' MSEs and depth correlations, taken together, can give.

    Args:
        printed: Method to its MSE and depth correlation.
        n: Number of samplings.

    Returns:
        `pairs` of methods, those among them whose two differences have `opposite` signs, and the
        p-value, by the `normal` approximation, of n small differences of one sign and n larger
        ones of the other.
    """
    of_pairs = [np.subtract(printed[a], printed[b]) for a, b in combinations(printed, 2)]
    differences = np.arange(1.0, 2 * n + 1) * np.repeat([-1, 1], n)
    test = wilcoxon_table({"a": differences, "b": np.zeros(2 * n)}).iloc[0]
    return {
        "pairs": len(of_pairs),
        "opposite": sum(bool(mse * correlation < 0) for mse, correlation in of_pairs),
        "normal": float(test.p_value_normal),
    }


def false_positives(
    difference: np.ndarray,
    samplings: list[int],
    size: int,
    level: float,
    rng: np.random.Generator,
    simulations: int = _SIMULATIONS,
) -> dict[str, float]:
    """Share of cases in which methods that only chance tells apart come out as different.

    In every simulation the two methods exchange their errors for a random half of the faces, so
    that neither is the better one. Then the paper's procedure: random samplings of the faces, and
    the Wilcoxon test over their mean differences.

    Args:
        difference: `(n,)` error of one method less that of the other, for each face.
        samplings: Numbers of samplings.
        size: Faces of each, at most n.
        level: Of significance.
        rng: Source of the random numbers.
        simulations: How many.

    Returns:
        Share of the simulations with p below the level, by number of samplings; and of the test
        over all faces under `"faces"`.
    """
    n, most = len(difference), max(samplings)
    signs = rng.choice([-1.0, 1.0], (simulations, n))
    means = np.empty((simulations, most))
    for own, exchanged in zip(means, signs * difference, strict=True):
        faces = np.argpartition(rng.random((most, n)), size - 1, axis=1)[:, :size]
        own[:] = exchanged[faces].mean(1)
    rates = {
        str(k): float(np.mean(wilcoxon(means[:, :k], axis=1).pvalue < level)) for k in samplings
    }
    ranks = rankdata(np.abs(difference))
    z = signs @ (ranks * np.sign(difference)) / np.sqrt((ranks**2).sum())
    return rates | {"faces": float(np.mean(2 * norm.sf(np.abs(z)) < level))}


def p_value(p_values: Mapping, printed_p: float, criteria: Mapping, n_subsets: float) -> Finding:
    """Ten values a method give a Wilcoxon p-value of 8.8e-5."""
    given = round(n_subsets)
    of_given = p_values[str(given)]
    evidence = (
        f"{given} differences, all of one sign, give the least p-value that {given} can, "
        f"{scientific(of_given['exact'], 3)} (by the normal approximation "
        f"{scientific(of_given['normal'], 3)})"
    )
    if any(_as_printed(p, printed_p) for p in of_given.values()):
        return holds(f"{evidence}, printed as {scientific(printed_p, 2)}.")
    fitting = [
        f"{n} ({scientific(p, 3)}, {'normal approximation' if kind == 'normal' else kind})"
        for n, of_n in p_values.items()
        for kind, p in of_n.items()
        if _as_printed(p, printed_p)
    ]
    takes = enumeration(fitting) or f"another number than {min(_NUMBERS)} to {max(_NUMBERS)}"
    together = scientific(criteria["normal"], 2)
    return does_not_hold(
        f"{evidence}; {scientific(printed_p, 2)} takes {takes}. MSEs and depth correlations "
        f"together would be {2 * given} values. But in the paper's table they differ in opposite "
        f"directions for {criteria['opposite']} of {criteria['pairs']} pairs of methods. That "
        f"gives {together}, unless the sign of one criterion is turned round."
    )


def p_value_of_casia(
    p_values: Mapping, printed_p_casia: float, criteria_casia: Mapping, n_subsets: float
) -> Finding:
    """The same of CASIA-3D, where the paper prints the same number."""
    return p_value(p_values, printed_p_casia, criteria_casia, n_subsets)


def samplings(
    false_positives: Mapping, sampled: Mapping, n_faces: int, pairs: Mapping, level: float
) -> Finding:
    """Random samplings of 500 of the test faces show which methods differ significantly."""
    rate = false_positives[str(sampled["samplings"])]
    more = {n: share for n, share in false_positives.items() if n.isdigit()}
    del more[str(sampled["samplings"])]
    evidence = (
        f"{sampled['samplings']} samplings of {sampled['faces']:,} of {n_faces:,} faces are "
        f"compared. Two methods that differ by chance alone come out as significantly different at "
        f"{_percent(level)} in {_percent(rate)} of the cases; in "
        + enumeration([f"{_percent(share)} with {n} samplings" for n, share in more.items()])
        + ". Samplings of one test set share its luck. The same test over the faces "
        f"themselves errs in {_percent(false_positives['faces'])}."
    )
    if rate <= TOO_OFTEN * level:
        return holds(evidence)
    if pairs["largest_p"] < level:
        return holds_if(
            "if the faces themselves are compared, not samplings of them",
            f"{evidence} Over the faces all {pairs['n']} pairs of the paper's methods do differ "
            f"(p {_at_most(pairs['largest_p'])}).",
        )
    return does_not_hold(
        f"{evidence} Over the faces {pairs['differ']} of {pairs['n']} pairs of the paper's methods "
        f"differ (largest p {scientific(pairs['largest_p'], 2)})."
    )


def over_faces(errors: Mapping[str, np.ndarray], level: float) -> dict[str, float]:
    """Wilcoxon tests of every two methods over the faces, whose `(n,)` errors are given.

    Returns:
        `n` pairs, those that `differ` at the level, and the `largest_p`.
    """
    p_values = wilcoxon_table(errors)["p_value"]
    return {
        "n": len(p_values),
        "differ": int((p_values < level).sum()),
        "largest_p": float(p_values.max()),
    }


def _as_printed(p: float, printed: float) -> bool:
    """Whether p is the printed number, rounded or cut off after its second digit."""
    return abs(p - printed) < 10.0 ** (np.floor(np.log10(printed)) - 1)


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


def _at_most(p: float) -> str:
    return f"at most {scientific(p, 2)}" if p > 0 else "too small for a number"
