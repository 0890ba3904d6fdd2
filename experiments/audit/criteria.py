"""Claims on the paper's two criteria, MSE and depth correlation, and on its numbers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.stats import spearmanr

from data_gen.models.morphable_model import MorphableModel
from deepmds_keras import metrics
from deepmds_keras.alignment import align
from deepmds_keras.normalisation import centre, normalise
from experiments.audit.evidence import Inputs
from experiments.audit.findings import Finding, does_not_hold, holds, holds_if, unknown
from experiments.methods import title
from experiments.published import printed_number, published
from experiments.scoring.numbers import enumeration, scientific
from experiments.scoring.scores import Scores
from experiments.streams import Stream

# A criterion that leaves this share of its maximum to an answer without depth tells nothing.
NEARLY_ALL = 0.9
# A formula further than this from the printed number is not the one that was computed.
ANOTHER_SIZE = 10.0
_SCHEMES = ("ibug51", "ibug68")
_WHOLE = 0.5  # of the correlations on CASIA-3D, that the paper prints without decimals
_ANSWERS = {
    "mean_shape": "the mean shape",
    "flat": "a face without depth",
    "cloud": "a random cloud of points",
    "point": "all landmarks in one point",
    "inverted": "a face turned inside out",
    "inverted_unreflected": "the same where no reflection is allowed",
}


def measure(inputs: Inputs) -> dict:
    """Both criteria, in every reading, of predictions, of answers without depth and of noise."""
    rng = np.random.default_rng([inputs.run.seed, Stream.AUDIT_CRITERIA])
    truth = inputs.test.shapes[inputs.audited].astype(float)
    answers = trivial_predictions(truth, inputs.predictions["mean_shape"][inputs.audited], rng)
    centred = trivial_predictions(centre(truth), answers["mean_shape"], rng)
    return {
        "mse_readings": mse_readings(inputs.scores["ours"].aligned, inputs.test.shapes),
        "printed_mse": printed_number("tab:cmp_bfm", "mse", "ours"),
        "depth_corr": {name: _trace(answer, truth) for name, answer in answers.items()},
        "depth_corr_centred": {name: _trace(a, centre(truth)) for name, a in centred.items()},
        "across_faces": {k: metrics.depth_corr_across_faces(a, truth) for k, a in answers.items()},
        "order": rank_correlation(inputs.scores, inputs.test.shapes),
        "printed_depth_corr": [
            number
            for track in ("bfm", "celeba")
            for number in _printed(track, "depth_corr").values()
        ],
        "printed_on_casia": _printed("flame", "depth_corr"),
        "on_casia": of_noise(inputs.model, _printed("flame", "mse"), len(inputs.audited), rng),
    }


def mse_readings(aligned: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """The printed formula, and what else it could stand for, each as a mean over the faces.

    Args:
        aligned, truth: `(n, L, 3)`, in the unit of the paper.

    Returns:
        `sum_of_coordinates` and `sum_of_distances`: the printed formula, with absolute values of
        coordinates or lengths of vectors; `mean_…`: the same with a mean over landmarks for the
        sum; `mean_of_squares`: over all coordinates; `root_mean_square` of each face.
    """
    difference = aligned - truth.astype(float)
    coordinates, distances = np.abs(difference).sum(2), np.linalg.norm(difference, axis=2)
    squares = metrics.mse(aligned, truth)
    readings = {
        "sum_of_coordinates": coordinates.sum(1),
        "sum_of_distances": distances.sum(1),
        "mean_of_coordinates": coordinates.mean(1),
        "mean_of_distances": distances.mean(1),
        "root_mean_square": np.sqrt(squares),
        "mean_of_squares": squares,
    }
    return {name: float(values.mean()) for name, values in readings.items()}


def trivial_predictions(
    truth: np.ndarray, mean_shape: np.ndarray, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Answers that know little or nothing of the depth, aligned as predictions are; and the truth.

    Args:
        truth: `(n, L, 3)`.
        mean_shape: Predictions of that method, of the same shape.
        rng: Of the cloud of points.

    Returns:
        `"truth"` and the keys of `_ANSWERS` to `(n, L, 3)`.
    """
    flat, inside_out = truth.copy(), truth * (1, 1, -1)
    flat[..., 2] = truth[..., 2].mean(1, keepdims=True)
    answers = {
        "truth": truth,
        "mean_shape": mean_shape,
        "flat": flat,
        "cloud": rng.standard_normal(truth.shape),
        "point": np.zeros_like(truth),
        "inverted": inside_out,
    }
    aligned = {name: align(answer, truth) for name, answer in answers.items()}
    return aligned | {"inverted_unreflected": align(inside_out, truth, reflection=False)}


def rank_correlation(scores: Mapping[str, Scores], truth: np.ndarray) -> float:
    """Spearman's, over methods, of what lacks in the depth correlation with the error of the depth.

    Args:
        scores: Method to its scores on all test faces.
        truth: `(n, L, 3)`.
    """
    lacking = [-own.depth_corr.mean() for own in scores.values()]
    errors = [np.mean((own.aligned - truth)[..., 2] ** 2) for own in scores.values()]
    return float(spearmanr(lacking, errors).statistic)


def of_noise(
    model: MorphableModel, mse: Mapping[str, float], n: int, rng: np.random.Generator
) -> dict[str, dict[str, dict[str, float]]] | None:
    """Depth correlation on faces with 51 and 68 landmarks, of a cloud and of faces with noise.

    It depends on where the origin is, and where the paper has it for these faces is not known.

    Args:
        model: Face model.
        mse: Method to a printed MSE, that the noise is given.
        n: Number of faces.
        rng: Of faces and noise.

    Returns:
        By origin, the `"model"`'s as far as the paper's unit keeps it or the mean of the
        `"landmarks"`, and by number of landmarks: `"truth"`, `"cloud"` and each method. None where
        the model lacks landmarks.
    """
    if not set(_SCHEMES) <= model.landmarks.keys():
        return None
    found: dict = {"model": {}, "landmarks": {}}
    for scheme in _SCHEMES:
        _, points = model.restrict(model.landmarks[scheme]).sample(n, rng)
        in_unit = normalise(points)
        noise = rng.standard_normal(in_unit.shape)
        for origin, truth in (("model", in_unit), ("landmarks", centre(in_unit))):
            shapes = {"truth": truth, "cloud": noise}
            shapes |= {method: truth + error**0.5 * noise for method, error in mse.items()}
            found[origin][str(truth.shape[1])] = {
                name: _trace(align(shape, truth), truth) for name, shape in shapes.items()
            }
    return found


def mse_formula(mse_readings: Mapping, printed_mse: float) -> Finding:
    """The criterion MSE is the sum over landmarks of absolute differences."""
    number = {name: scientific(value, 3) for name, value in mse_readings.items()}
    evidence = (
        f"On the predictions of {title('ours')} the printed formula gives "
        f"{number['sum_of_coordinates']}, or {number['sum_of_distances']} with the lengths of "
        f"vectors. With a mean over landmarks for the sum it gives "
        f"{number['mean_of_coordinates']} or {number['mean_of_distances']}. The mean of "
        f"squares over all coordinates gives {number['mean_of_squares']} and its root "
        f"{number['root_mean_square']}; the paper prints {scientific(printed_mse, 3)}."
    )
    near = {
        name: max(value / printed_mse, printed_mse / value) <= ANOTHER_SIZE
        for name, value in mse_readings.items()
    }
    if near["sum_of_coordinates"] or near["sum_of_distances"]:
        return holds(evidence)
    if near["mean_of_coordinates"] or near["mean_of_distances"]:
        return holds_if("with the mean over landmarks in the place of the sum", evidence)
    if near["mean_of_squares"]:
        return does_not_hold(evidence)
    return unknown("a reading that gives numbers of the printed size", evidence)


def depth_corr_meaning(
    depth_corr: Mapping, depth_corr_centred: Mapping, across_faces: Mapping, order: float
) -> Finding:
    """The depth correlation measures how well the depth of the landmarks is recovered."""
    shares, centred, across = (
        {name: value / criterion["truth"] for name, value in criterion.items()}
        for criterion in (depth_corr, depth_corr_centred, across_faces)
    )
    evidence = (
        f"What is kept of the maximum of {scientific(depth_corr['truth'])}: "
        + "; ".join(f"{_percent(shares[key])} by {name}" for key, name in _ANSWERS.items())
        + f". With the origin at the mean of the landmarks {_ANSWERS['flat']} keeps "
        f"{_percent(centred['flat'])} and a random cloud {_percent(centred['cloud'])}. Of the "
        f"correlation across faces, which the paper cites, they keep {_percent(across['flat'])} "
        f"and {_percent(across['cloud'])}. What the methods of the table lack of the maximum does "
        f"follow the error of their depth (rank correlation {scientific(order, 2)}): their order "
        "says something, the number hardly anything."
    )
    if max(shares["flat"], shares["cloud"]) <= NEARLY_ALL:
        return holds(evidence)
    if max(centred["flat"], centred["cloud"]) <= NEARLY_ALL:
        return holds_if(
            "with the origin at the mean of the landmarks, unlike the paper's", evidence
        )
    return does_not_hold(evidence)


def depth_corr_percent(depth_corr: Mapping, printed_depth_corr: list[float]) -> Finding:
    """The depth correlation is a percentage."""
    maximum = depth_corr["truth"]
    low, high = min(printed_depth_corr), max(printed_depth_corr)
    evidence = (
        f"A prediction without error scores {scientific(maximum)}. The printed {low:g} to {high:g} "
        f"are {_percent(low / maximum)} to {_percent(high / maximum)} of that; read as percentages "
        f"they would be {scientific(low / 100 * maximum, 3)} to "
        f"{scientific(high / 100 * maximum, 3)}, where a random cloud of points scores "
        f"{scientific(depth_corr['cloud'], 3)}."
    )
    return holds(evidence) if round(maximum, 3) == 100 else does_not_hold(evidence)


def casia_depth_corr(on_casia: Mapping | None, printed_on_casia: Mapping) -> Finding:
    """Depth correlations of 60 to 68 on 51 landmarks."""
    if on_casia is None:
        return unknown("a face model with 51 and 68 landmarks")
    fewer, more = on_casia["model"]
    maximum = on_casia["model"][fewer]["truth"]
    evidence = f"The maximum on {fewer} landmarks is {scientific(maximum)}; the paper prints " + (
        enumeration([f"{value:g} ({title(method)})" for method, value in printed_on_casia.items()])
    )
    if max(printed_on_casia.values()) <= maximum:
        return holds(f"{evidence}.")
    readings = {
        f"sums over {more} landmarks": [of[more] for of in on_casia.values()],
        f"percentages of the maximum on {fewer}": [
            {name: 100 * value / maximum for name, value in of[fewer].items()}
            for of in on_casia.values()
        ],
    }
    for reading, (by_model, by_mean) in readings.items():
        evidence += (
            f". As {reading} faces with noise of the printed MSEs score "
            f"{_range(by_model, printed_on_casia)} and a random cloud "
            f"{scientific(by_model['cloud'], 3)}; with the origin at the mean of the landmarks "
            f"{_range(by_mean, printed_on_casia)} and {scientific(by_mean['cloud'], 3)}"
        )
    evidence += ". Errors of another kind than noise may score otherwise."
    for reading, scores in readings.items():
        for of in scores:
            if all(abs(of[m] - value) <= _WHOLE for m, value in printed_on_casia.items()):
                return holds_if(f"if they are {reading}, which the paper does not say", evidence)
    return does_not_hold(evidence)


def _trace(aligned: np.ndarray, truth: np.ndarray) -> float:
    return float(metrics.depth_corr(aligned, truth).mean())


def _percent(share: float) -> str:
    return f"{scientific(100 * share)} %"


def _range(scores: Mapping, methods: Mapping) -> str:
    of_methods = [scores[method] for method in methods]
    return f"{scientific(min(of_methods), 3)} to {scientific(max(of_methods), 3)}"


def _printed(experiment: str, metric: str) -> dict[str, float]:
    """Method to what the paper prints of it in the table of an experiment."""
    rows = published(experiment)
    rows = rows[rows["metric"] == metric]
    return dict(zip(rows["method"], map(float, rows["paper_mean"]), strict=True))
