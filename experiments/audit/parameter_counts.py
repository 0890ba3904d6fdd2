"""Claims on trainable parameters, and on the time that they are exchanged for."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from types import SimpleNamespace

import pandas as pd

from deepmds_keras.baselines.mobileface import build_mobileface_net
from deepmds_keras.baselines.ringnet_net import build_ringnet
from deepmds_keras.baselines.zhao import build_zhao_net
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.networks import build_autoencoder, build_dissimilarity_net, count_trainable
from deepmds_keras.proximities import VARIANTS
from experiments.audit.evidence import Inputs
from experiments.audit.findings import Finding, does_not_hold, holds, holds_if, unknown
from experiments.methods import title
from experiments.published import printed_number
from experiments.scoring.numbers import enumeration, scientific
from experiments.timing import prediction_times

# The paper counts its table at 72 landmarks; the half of its experiments with FLAME has 51.
_N_LANDMARKS = {scheme: len(load_scheme(scheme)) for scheme in ("bfm72", "ibug51")}
_BASEL_COMPONENTS = (
    199  # identity components of the Basel Face Model 2009, doi:10.1109/AVSS.2009.58
)
_RINGNET = (100, 50)  # identity and expression coefficients that the published RingNet finds
# "Far fewer" parameters are less than half as many.
FAR_FEWER = 2.0
# The embedding is what slows a prediction if it takes more than half of its time.
MOST = 0.5


def measure(inputs: Inputs) -> dict:
    """Parameters of every network, as built, beside the printed ones; errors; times."""
    n_landmarks = _N_LANDMARKS["bfm72"]
    return {
        "autoencoder": _counts(build_autoencoder(n_landmarks)),
        "dissimilarity_nets": {
            variant: _counts(build_dissimilarity_net(variant)) for variant in VARIANTS
        },
        "zhao_by_landmarks": {
            str(n): count_trainable(build_zhao_net(n)) for n in _N_LANDMARKS.values()
        },
        "mobileface_net": _counts(build_mobileface_net(_BASEL_COMPONENTS)),
        "ringnet_net": _counts(build_ringnet(*_RINGNET)),
        "linear_parameters": int(inputs.method("linear").n_parameters),
        "printed": {
            method: printed_number("tab:cmp_param", "n_parameters", method)
            for method in ("ours", "zhao", "mobileface", "ringnet", "aldrian")
        },
        "errors": {
            method: float(inputs.scores[method].mse.mean()) for method in ("ours", "linear")
        },
        "milliseconds": milliseconds_of(inputs.results("bfm")),
        "embedding_share": embedding_share(
            inputs.method("ours"), inputs.test.views[: inputs.run.preset.timed_faces]
        ),
    }


def embedding_share(model, views) -> float:
    """Part of the time of a prediction that the embedding takes, in one process.

    Args:
        model: Trained `DeepMDS`.
        views: `(n, L, 2)`.
    """
    timed = copy(model)
    timed.solver = "sklearn"  # as the predictions of the table are made
    networks = SimpleNamespace(predict=model.dissimilarities)
    whole, part = prediction_times([timed, networks], [views, views])
    return max(0.0, 1 - part["ms_per_face"] / whole["ms_per_face"])


def below_bound(dissimilarity_nets: Mapping, bound: float) -> Finding:
    """The dissimilarity net has less than 3,000 trainable parameters."""
    evidence = (
        "The dissimilarity net has "
        + "; ".join(f"{_of(net)} with {_features(v)}" for v, net in dissimilarity_nets.items())
        + "."
    )
    below = [v for v, net in dissimilarity_nets.items() if net["trainable"] < bound]
    if len(below) == len(dissimilarity_nets):
        return holds(evidence)
    if below:
        return holds_if(f"with {enumeration([*map(_features, below)])}", evidence)
    return does_not_hold(evidence)


def ours(autoencoder: Mapping, dissimilarity_nets: Mapping, printed: Mapping) -> Finding:
    """The framework has 27,505 trainable parameters."""
    sums = {v: autoencoder["trainable"] + n["trainable"] for v, n in dissimilarity_nets.items()}
    evidence = (
        f"At {_N_LANDMARKS['bfm72']} landmarks the autoencoder has {_of(autoencoder)}; the "
        "dissimilarity net "
        + "; ".join(f"{_of(net)} with {_features(v)}" for v, net in dissimilarity_nets.items())
        + ". The trainable ones of both are "
        + " or ".join(f"{n:,} with {_features(v)}" for v, n in sums.items())
        + "."
    )
    if printed["ours"] in sums.values():
        return holds(evidence)
    for variant, net in dissimilarity_nets.items():
        if autoencoder["trainable"] + net["total"] == printed["ours"]:
            return holds_if(
                f"if {net['total'] - net['trainable']:,} numbers of the dissimilarity net that "
                "nothing trains, the moving statistics of its batch normalisation, count too",
                f"{evidence} The printed {printed['ours']:,.0f} is the trainable ones of the "
                f"autoencoder and all of the dissimilarity net with {_features(variant)}: "
                f"{autoencoder['trainable']:,} + {net['total']:,}.",
            )
    return does_not_hold(evidence)


def zhao(zhao_by_landmarks: Mapping, printed: Mapping) -> Finding:
    """Zhao's network has 114,840 trainable parameters."""
    of_bfm, of_flame = (zhao_by_landmarks[str(n)] for n in _N_LANDMARKS.values())
    evidence = (
        f"Zhao's network has {of_bfm:,} trainable parameters at {_N_LANDMARKS['bfm72']} landmarks. "
        f"At the {_N_LANDMARKS['ibug51']} of the paper's experiments with FLAME it has "
        f"{of_flame:,}; the paper prints {printed['zhao']:,.0f}."
    )
    return holds(evidence) if of_bfm == printed["zhao"] else does_not_hold(evidence)


def mobileface(mobileface_net: Mapping, printed: Mapping) -> Finding:
    """MobileFace has 900,979 trainable parameters."""
    evidence = (
        f"MobileFace has {_of(mobileface_net)} for the {_BASEL_COMPONENTS} components of the Basel "
        f"model; the paper prints {printed['mobileface']:,.0f}."
    )
    same = mobileface_net["trainable"] == printed["mobileface"]
    return holds(evidence) if same else does_not_hold(evidence)


def ringnet(ringnet_net: Mapping, printed: Mapping) -> Finding:
    """RingNet has more than 23,000,000 trainable parameters."""
    evidence = (
        f"RingNet, built anew from its description, has {_of(ringnet_net)} for {_RINGNET[0]} "
        f"identity and {_RINGNET[1]} expression coefficients."
    )
    more = ringnet_net["trainable"] > printed["ringnet"]
    return holds(evidence) if more else does_not_hold(evidence)


def fewest(
    autoencoder: Mapping,
    dissimilarity_nets: Mapping,
    zhao_by_landmarks: Mapping,
    mobileface_net: Mapping,
    ringnet_net: Mapping,
    linear_parameters: int,
    printed: Mapping,
    errors: Mapping,
) -> Finding:
    """The framework has far fewer trainable parameters than the compared methods."""
    own = autoencoder["trainable"] + dissimilarity_nets["paper"]["trainable"]
    compared = {
        "zhao": zhao_by_landmarks[str(_N_LANDMARKS["bfm72"])],
        "mobileface": mobileface_net["trainable"],
        "ringnet": ringnet_net["trainable"],
        "aldrian": round(printed["aldrian"]),
    }
    evidence = (
        f"{title('ours')} has {own:,} trainable parameters; "
        + enumeration([f"{title(method)} {count:,}" for method, count in compared.items()])
        + f". Few are worth what they buy: a linear map from the view to the shape has "
        f"{linear_parameters:,} and an MSE of {scientific(errors['linear'], 3)}, "
        f"{title('ours')} {scientific(errors['ours'], 3)}."
    )
    trained = {method: count for method, count in compared.items() if count}
    if min(trained.values()) < FAR_FEWER * own:
        return does_not_hold(evidence)
    untrained = [title(method) for method in compared if method not in trained]
    if untrained:
        return holds_if(
            f"among the methods that are trained; {enumeration(untrained)} is not, but is given a "
            "face model",
            evidence,
        )
    return holds(evidence)


def inference_time(milliseconds: Mapping, embedding_share: float) -> Finding:
    """In exchange for few parameters the MDS step makes inference slower."""
    if "ours" not in milliseconds:
        return unknown("`make reproduce-bfm`")
    own, times = milliseconds["ours"], {m: milliseconds[m] for m in milliseconds if m != "ours"}
    networks = {m: time for m, time in times.items() if m in ("zhao", "mobileface")}
    evidence = (
        f"A face takes {title('ours')} {scientific(own, 2)} ms, of which the embedding takes "
        f"{100 * embedding_share:.2g} %; "
        + enumeration([f"{title(method)} {scientific(t, 2)} ms" for method, t in times.items()])
        + "."
    )
    if own <= max(networks.values()) or embedding_share <= MOST:
        return does_not_hold(evidence)
    slower = scientific(own / max(networks.values()), 2)
    return holds(f"{evidence} That is {slower} times the slowest of the compared networks.")


def aldrian_slower(milliseconds: Mapping) -> Finding:
    """Aldrian's method takes longer for a face than the framework."""
    fits = {m: own for m, own in milliseconds.items() if m.startswith("aldrian")}
    if "ours" not in milliseconds or not fits:
        return unknown("`make reproduce-bfm`")
    ours = milliseconds["ours"]
    evidence = (
        f"A face takes {title('ours')} {scientific(ours, 2)} ms, with scikit-learn's MDS; "
        + enumeration([f"{title(method)} {scientific(own, 2)} ms" for method, own in fits.items()])
        + ". Both are this project's code, in Python on one core."
    )
    return holds(evidence) if ours < min(fits.values()) else does_not_hold(evidence)


def _counts(network) -> dict[str, int]:
    return {"trainable": count_trainable(network), "total": network.count_params()}


def _features(variant: str) -> str:
    whose = {"paper": "the paper", "released": "the released code"}[variant]
    return f"the {VARIANTS[variant]} features of {whose}"


def _of(counts: Mapping) -> str:
    return f"{counts['trainable']:,} trainable parameters of {counts['total']:,}"


def milliseconds_of(metrics: pd.DataFrame | None) -> dict[str, float]:
    """Time of a prediction by method of the paper's table; none where that target was not run."""
    if metrics is None:
        return {}
    times = metrics[metrics["metric"] == "ms_per_face"].set_index("method")["value"]
    compared = ("ours", "zhao", "mobileface", "aldrian", "aldrian_authors")
    return {method: float(times[method]) for method in compared if method in times}
