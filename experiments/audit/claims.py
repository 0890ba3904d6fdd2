"""The claims: numbers by which each is decided, and the decision.

A claim and its conditions are a row of `results/published/claims.csv`. Conditions compare numbers
of `numbers_of` with bounds: `deep_mds_over_mean_shape < 1; rank = 2`. Where the authors' fit,
evaluator or list of points makes a difference, the claim has conditions for their protocol too.
"""

import math
import operator
import re
from collections.abc import Mapping, Sequence

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.landmarks import load_scheme
from experiments.audit.tables import Tables
from experiments.scoring.intervals import (
    Estimate,
    holm,
    over_samplings,
    over_seeds,
    point,
    rate,
    sd_of_seeds,
    share_below,
)
from experiments.scoring.wilcoxon import wilcoxon_table

SUPPORTED, REFUTED, UNDECIDED = "supported", "refuted", "undecided"
NOT_TESTABLE = "not testable here"
_CONDITION = re.compile(r"(\w+) ([<>=]) (-?[\d.e-]+)")
_SIGNS = {"<": operator.lt, ">": operator.gt, "=": math.isclose}
# Trained here for a tenth of the published steps, and with the published weights.
_RINGNETS = ("ringnet", "ringnet_licensed")
INDICATIVE = "one training: indicative"
_COMPARED = ("zhao", "aldrian", "mobileface")
_AS_AUTHORS = ("zhao_evaluator", "aldrian_authors", "mobileface")  # as they made and scored them


def numbers_of(t: Tables) -> dict[str, dict[str, Estimate]]:
    """Claim → name → each number that bears on it; NaN where the tables lack it."""
    ours, mean_shape, deep_mds_constant = map(
        t.seeds, ("deep_mds", "mean_shape", "deep_mds_constant")
    )
    constant = t.measured("constants", "mse", answer="frontal_view").value
    frontal = "autoencoder_mse_inference"
    pairs = dict.fromkeys(("method_a", "method_b"), ["deep_mds", *_COMPARED])
    p_values = t.values("bfm", "wilcoxon", "p_value", over="faces", metric="mse", **pairs)
    paper, connected = t.variant("same_face_cosine"), t.variant("same_face")
    evaluator = "bfm-evaluator-released"
    posed = t.variant("same_face", "mse_posed")  # on turned and perspective views
    return {
        "bfm-rank": {
            "rank": _rank(t, ours, _COMPARED),
            "authors_rank": _rank(t, ours, _AS_AUTHORS),
            **{
                f"deep_mds_over_{method}": over_seeds(ours / t.error(method))
                for method in ("mobileface", "aldrian", "zhao", "aldrian_authors")
            },
            "seeds_below_aldrian_authors": share_below(ours, t.error("aldrian_authors")),
        },
        "trivial-case": {
            "deep_mds_over_deep_mds_constant": over_seeds(ours / deep_mds_constant),
            "seeds_below_deep_mds_constant": share_below(ours, deep_mds_constant),
            "deep_mds_over_mean_shape": over_seeds(ours / mean_shape),
            "seeds_below_mean_shape": share_below(ours, mean_shape),
            "deep_mds_mse": over_seeds(ours),
            "deep_mds_constant_mse": over_seeds(deep_mds_constant),
            "mean_shape_mse": over_seeds(mean_shape),
        },
        "unbiased": {
            f"recovered_{method}": t.over_faces("bias", "slope", "slope_se", method=method)
            for method in (
                "deep_mds",
                "deep_mds_cosine",
                "aldrian",
                "mobileface",
                "ridge",
                "landmark_lifter",
            )
        },
        "training-luck": {
            "seed_sd_mse": sd_of_seeds(ours),
            "seed_sd_cosine_mse": sd_of_seeds(t.seeds("deep_mds_cosine")),
            "sampling_sd_mse": point(np.std(t.samplings("deep_mds"), ddof=1)),
        },
        "projection-independent": {
            "posed_over_mean_shape": over_seeds(posed / t.error("mean_shape")),
            "posed_over_frontal": over_seeds(posed / t.variant("same_face", "mse_frontal")),
        },
        "autoencoder-needed": {
            "posed_without_over_with": over_seeds(t.variant("no_autoencoder", "mse_posed") / posed),
            "frontal_over_constant": over_seeds(t.seeds("deep_mds", frontal) / constant),
            "frontal_over_constant_cosine": over_seeds(
                t.seeds("deep_mds_cosine", frontal) / constant
            ),
        },
        "zhao-score": {
            "zhao_over_deep_mds": over_seeds(t.error("zhao") / ours),
            "zhao_evaluator_over_deep_mds": over_seeds(t.error("zhao_evaluator") / ours),
            **{
                f"{method}_mse": over_samplings(t.samplings(method))
                for method in ("zhao_frontal", "zhao", "zhao_authors")
            },
            "zhao_frontal_released_mse": over_samplings(t.samplings("zhao_frontal", evaluator)),
            "zhao_true_depth_released_mse": over_samplings(
                t.samplings("zhao_true_depth", evaluator)
            ),
        },
        "depth-correlation": {
            "largest_depth_corr": point(len(load_scheme(t.run.scheme))),
            **{
                f"{answer}_share": t.measured("depth", "share", answer=answer)
                for answer in ("flat", "cloud", "point", "mean_shape")
            },
        },
        "p-values": {
            "least_p_value": _least_p_value(10, "p_value"),
            "least_p_value_normal": _least_p_value(10),
            "least_p_value_normal_of_20": _least_p_value(20),
            "false_positives": _false_positives(t, str(t.run.preset.n_subsets)),
            "false_positives_of_20": _false_positives(t, "20"),
            "false_positives_of_50": _false_positives(t, "50"),
            "false_positives_of_faces": _false_positives(t, "faces"),
            "largest_p_over_faces": point(p_values.max()),
        },
        "celeba": {
            f"celeba_over_{method}{suffix}": _deep_mds_over(t, method, experiment)
            for suffix, experiment in {"": "celeba", "_true": "celeba-true-landmarks"}.items()
            for method in ("aldrian", "mobileface", "aldrian_authors", "mean_shape")
        },
        "casia-comparable": {
            f"casia_over_{method}{suffix}": _deep_mds_over(t, method, experiment)
            for suffix, experiment in {"": "flame", "_true": "flame-true-landmarks"}.items()
            for method in ("mediapipe", "mediapipe_corrected", *_RINGNETS, "mean_shape")
        },
        "mini-batches": holm(
            {
                f"same_face_over_shuffled_{metric}{end}": (
                    t.variant(f"same_face{end}", metric) / t.variant(f"shuffled{end}", metric)
                )
                for end in ("", "_cosine")
                for metric in ("mse", "loss_inference", "loss_train")
            }
        ),
        "five-layers": holm(
            {
                f"paper_over_{depth}_layers": paper / t.variant(f"{depth}_layers_cosine")
                for depth in ("two", "three", "five", "eight")
            }
            | {"with_over_without_connection": connected / t.variant("no_skip_connection")}
        ),
        "perspective-views": {
            "text_max": t.measured("perspective", "max", views="text"),
            "text_rms": t.measured("perspective", "rms", views="text"),
            "released_max": t.measured("perspective", "max", views="released"),
        },
        "distance-rank": {"rank_less_dimensions": _rank_less_dimensions(t)},
        "parameters-deep-mds": {
            f"trainable_parameters_{method}": point(t.samplings(method, metric="n_parameters")[0])
            for method in ("deep_mds", "deep_mds_released")
        },
    }


def _rank(t: Tables, deep_mds: np.ndarray, others: Sequence[str]) -> Estimate:
    """Place of each seed of Deep-MDS, by MSE, among one training of each of the others."""
    return over_seeds(1 + sum(np.heaviside(deep_mds - t.error(method), 0) for method in others))


def _deep_mds_over(t: Tables, method: str, experiment: str) -> Estimate:
    """Ratio of the MSEs of Deep-MDS and another method on the same samplings."""
    return over_samplings(t.samplings("deep_mds", experiment) / t.samplings(method, experiment))


def _false_positives(t: Tables, samplings: str) -> Estimate:
    """Rate at which a test finds methods different that differ by chance alone."""
    share = t.measured("samplings", "rate", samplings=samplings).value
    return rate(share, t.run.preset.simulations, "simulations")


def _least_p_value(n: int, kind: str = "p_value_normal") -> Estimate:
    """p-value of n differences of one sign."""
    return point(wilcoxon_table({"a": np.arange(1.0, n + 1), "b": np.zeros(n)})[kind][0])


def _rank_less_dimensions(t: Tables) -> Estimate:
    """Rank of squared distances, doubly centred, less the dimensions of clouds and faces."""
    excess = t.values("audit", "ranks", "centred") - t.values("audit", "ranks", "dimensions")
    return Estimate(np.median(excess), excess.min(), excess.max())


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

    A claim is refuted if one of its conditions is; else a missing number leaves it not testable;
    else an interval on both sides of its bound leaves it undecided.
    """
    found = [(name, _verdict(estimates.get(name), *of)) for name, *of in conditions(supported_if)]
    for verdict in (REFUTED, NOT_TESTABLE, UNDECIDED):
        for name, of_condition in found:
            if of_condition == verdict:
                return verdict, name
    return SUPPORTED, found[0][0]


def _verdict(estimate: Estimate | None, sign: str, bound: float) -> str:
    """Verdict on one condition: the whole interval is to meet it, or to miss it."""
    if estimate is None or math.isnan(estimate.low + estimate.high):
        return NOT_TESTABLE
    met = {bool(_SIGNS[sign](end, bound)) for end in (estimate.low, estimate.high)}
    straddles = len(met) == 2 or estimate.low < bound < estimate.high
    return UNDECIDED if straddles else SUPPORTED if met == {True} else REFUTED
