"""The claims: numbers by which each is decided, and the decision.

A claim and its conditions are a row of `results/published/claims.csv`. Conditions compare numbers
of `numbers_of` with bounds: `ours_over_mean_shape < 1; rank = 2`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

import numpy as np

from deepmds_keras.io.errors import InputError
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.metrics import wilcoxon_table
from experiments.audit.estimates import (
    Estimate,
    Tables,
    holm,
    over_samplings,
    over_seeds,
    point,
    share_below,
    spread_of_seeds,
    values,
)
from experiments.audit.poses import TRAINED

SUPPORTED, NOT_SUPPORTED, NOT_TESTABLE = "supported", "not supported", "not testable here"
_CONDITION = re.compile(r"(\w+) ([<>=]) (-?[\d.e-]+)")
_COMPARED = ("zhao", "aldrian", "mobileface")
_MOST_NOISE = 5  # percent of the interocular distance


def numbers_of(t: Tables) -> dict[str, dict[str, Estimate]]:
    """By claim and name, each number that bears on it; NaN where the tables lack it."""
    ours, mean_shape = t.seeds("ours"), t.seeds("mean_shape")
    own_output, training_face, frontal_view = (
        t.measured("constants", "mse", answer=answer)
        for answer in ("own_output", "training_face", "frontal_view")
    )
    # Of Deep-MDS on turned and perspective views.
    posed, released = t.variant("same_face", "mse_posed"), "bfm-evaluator-released"
    return {
        "bfm-rank": {
            "rank": over_seeds(1 + sum(np.heaviside(ours - t.error(m), 0) for m in _COMPARED)),
            **{
                f"ours_over_{method}": over_seeds(ours / t.error(method))
                for method in ("mobileface", "aldrian", "zhao", "aldrian_authors")
            },
            "seeds_below_aldrian_authors": share_below(ours, t.error("aldrian_authors")),
        },
        "trivial-case": {
            "ours_over_own_constant": over_seeds(ours / own_output.value),
            "seeds_below_own_constant": share_below(ours, own_output.value),
            "ours_over_mean_shape": over_seeds(ours / mean_shape),
            "seeds_below_mean_shape": share_below(ours, mean_shape),
            "ours_mse": over_seeds(ours),
            "own_constant_mse": own_output,
            "training_face_mse": training_face,
            "mean_shape_mse": over_seeds(mean_shape),
        },
        "unbiased": {
            **{
                f"recovered_{method}": t.recovered(method)
                for method in ("ours", "ours_stable", "aldrian", "mobileface", "linear", "lifting")
            },
            "systematic_share": t.measured("bias", "systematic_share", method="ours"),
        },
        "training-luck": {
            "seed_sd_mse": spread_of_seeds(ours),
            "seed_sd_stable_mse": spread_of_seeds(t.seeds("ours_stable")),
            "sampling_sd_mse": point(np.std(t.samplings("ours"), ddof=1)),
        },
        "projection-independent": {
            "posed_over_mean_shape": over_seeds(posed / t.error("mean_shape")),
            "posed_over_frontal": over_seeds(posed / t.variant("same_face", "mse_frontal")),
            "trained_views_over_mean_shape": _largest_over_mean_shape(t, trained=True),
            "all_views_over_mean_shape": _largest_over_mean_shape(t, trained=False),
        },
        "autoencoder-needed": {
            "posed_without_over_with": over_seeds(t.variant("no_autoencoder", "mse_posed") / posed),
            **{
                f"frontal_over_constant{suffix}": over_seeds(
                    t.seeds(f"ours{suffix}", "autoencoder_mse_inference") / frontal_view.value
                )
                for suffix in ("", "_stable")
            },
        },
        "zhao-score": {
            "zhao_over_ours": over_seeds(t.error("zhao") / ours),
            **{
                f"{method}_mse": over_samplings(t.samplings(method))
                for method in ("zhao_frontal", "zhao", "zhao_authors")
            },
            **{
                f"{method}_released_mse": over_samplings(t.samplings(method, released))
                for method in ("zhao_frontal", "zhao_true_depth")
            },
        },
        "depth-correlation": {
            "largest_depth_corr": point(len(load_scheme(t.run.scheme))),
            **{
                f"{answer}_{criterion}": t.measured("depth", criterion, answer=answer)
                for criterion in ("share", "share_centred", "share_across_faces")
                for answer in ("flat", "cloud", "point", "mean_shape")
            },
        },
        "p-values": {
            "least_p_value": _least_p_value(10, "p_value"),
            "least_p_value_normal": _least_p_value(10),
            "least_p_value_normal_of_20": _least_p_value(20),
            "false_positives": t.false_positives(t.run.preset.n_subsets),
            "false_positives_of_20": t.false_positives(20),
            "false_positives_of_50": t.false_positives(50),
            "false_positives_of_faces": t.false_positives("faces"),
            "largest_p_over_faces": _largest_p_over_faces(t),
        },
        "celeba": {
            f"celeba_over_{method}{suffix}": t.ours_over(method, experiment)
            for suffix, experiment in {"": "celeba", "_true": "celeba-true-landmarks"}.items()
            for method in ("aldrian", "mobileface", "aldrian_authors", "mean_shape")
        },
        "casia-comparable": {
            f"casia_over_{method}{suffix}": t.ours_over(method, experiment)
            for suffix, experiment in {"": "flame", "_true": "flame-true-landmarks"}.items()
            for method in ("mediapipe", "mediapipe_corrected", "ringnet", "mean_shape")
        },
        "mini-batches": holm(
            {
                f"same_face_over_shuffled_{m}{end}": t.ratio(f"same_face{end}", f"shuffled{end}", m)
                for end in ("", "_stable")
                for m in ("mse", "loss_inference", "loss_train")
            }
        ),
        "five-layers": holm(
            {
                f"paper_over_{depth}_layers": t.ratio("same_face_stable", f"{depth}_layers_stable")
                for depth in ("two", "three", "five", "eight")
            }
            | {"with_over_without_connection": t.ratio("same_face", "no_short_connection")}
        ),
        "perspective-views": {
            f"{views}_{of}": t.measured("perspective", of, views=views)
            for views, of in (
                ("text", "max"),
                ("text", "rms"),
                ("released", "max"),
                ("detector", "rms"),
                ("text", "share"),
                ("released", "share"),
            )
        },
        "distance-rank": {
            "rank_less_dimensions": _rank_less_dimensions(t),
            "rank_of_faces": t.measured("ranks", "centred", points="faces"),
            **{
                f"eigenvalue_{k}_{of}": t.measured("spectra", "share", matrix=of, eigenvalue=k)
                for k, of in ((3, "learnt"), (4, "learnt"), (3, "true"), (3, "frontal"))
            },
        },
        "parameters-ours": {
            f"trainable_parameters_{method}": point(t.samplings(method, metric="n_parameters")[0])
            for method in ("ours", "ours_released")
        },
        "landmark-noise": {
            **{
                f"noisy_{method}_over_mean_shape": _noisy_over(t, method, "mean_shape")
                for method in ("ours", "aldrian", "zhao")
            },
            "noisy_ours_over_exact": _noisy_over(t, "ours", "ours", percent=0),
        },
    }


def _largest_over_mean_shape(t: Tables, *, trained: bool) -> Estimate:
    """Largest error of ours over the sweeps of poses, in that of the mean shape."""
    table = t.table("audit", "curves")
    low, high = (table["sweep"].map({k: ends[i] for k, ends in TRAINED.items()}) for i in (0, 1))
    inside = table["value"].between(low, high) if trained else low.notna()
    worst = table[inside & (table["method"] == "ours")].nlargest(1, "mse")
    at = worst[["sweep", "value"]].iloc[0]
    return t.curve(*at, "ours").in_unit(t.curve(*at, "mean_shape").value)


def _noisy_over(t: Tables, method: str, other: str, percent: float = _MOST_NOISE) -> Estimate:
    """Error of a method with most noise, in that of another with some noise."""
    noisy = t.curve("noise_percent", _MOST_NOISE, method)
    return noisy.in_unit(t.curve("noise_percent", percent, other).value)


def _least_p_value(n: int, kind: str = "p_value_normal") -> Estimate:
    """Of n differences of one sign."""
    return point(wilcoxon_table({"a": np.arange(1.0, n + 1), "b": np.zeros(n)})[kind][0])


def _largest_p_over_faces(t: Tables) -> Estimate:
    """Of tests over all faces between any two of the methods that the paper compares."""
    table, compared = t.table("bfm", "wilcoxon"), ["ours", *_COMPARED]
    table = table[table["method_a"].isin(compared) & table["method_b"].isin(compared)]
    return point(values(table, "p_value", over="faces", metric="mse").max())


def _rank_less_dimensions(t: Tables) -> Estimate:
    """Rank of squared distances, doubly centred, less the dimensions of clouds and faces."""
    table = t.table("audit", "ranks").query("points in ('cloud', 'faces')")
    excess = table["centred"] - table["dimensions"]
    return Estimate(excess.median(), excess.min(), excess.max())


def conditions(text: str) -> list[tuple[str, str, float]]:
    """Number, comparison and bound of each condition in a cell of `supported_if`.

    Raises:
        InputError: It is not `number < bound`, with `<`, `>` or `=`, separated by semicolons.
    """
    matches = [_CONDITION.fullmatch(part.strip()) for part in text.split(";")]
    if None in matches:
        raise InputError(f"supported_if must be such as a < 1; b = 2. Received {text}.")
    return [(match[1], match[2], float(match[3])) for match in matches]


def decide(supported_if: str, estimates: Mapping[str, Estimate]) -> tuple[str, str]:
    """Verdict, and the number that decides it.

    A condition is met if the whole interval meets it. One that is not met decides; else one whose
    number is missing.
    """
    met = [(name, _is_met(estimates.get(name), *of)) for name, *of in conditions(supported_if)]
    for outcome, verdict in ((False, NOT_SUPPORTED), (None, NOT_TESTABLE)):
        for name, is_met in met:
            if is_met is outcome:
                return verdict, name
    return SUPPORTED, met[0][0]


def _is_met(estimate: Estimate | None, sign: str, bound: float) -> bool | None:
    """Whether an interval meets a condition; None where there is none."""
    if estimate is None or math.isnan(estimate.low + estimate.high):
        return None
    if sign == "=":
        return math.isclose(estimate.low, bound) and math.isclose(estimate.high, bound)
    return bool(estimate.high < bound if sign == "<" else estimate.low > bound)
