"""Whether shapes are drawn towards the mean shape."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from experiments.audit.evidence import Inputs
from experiments.audit.findings import Finding, does_not_hold, holds, holds_if
from experiments.methods import title
from experiments.scoring.numbers import enumeration, plus_minus

# Share of a face's offset from the mean that may be lost, and share of the squared error that may
# be the same for all faces, where a method still counts as unbiased.
TOLERANCE = 0.1
_MODEL_BASED = ("aldrian", "mobileface")
_METHODS = (
    "mean_shape", "linear", "zhao", *_MODEL_BASED, "ours", "ours_released", "ours_stable",
    "authors_weights", "lifting",
)  # fmt: skip


def measure(inputs: Inputs) -> dict:
    """`bias`: by method, how its shapes lie between the true ones and the mean training shape."""
    truth = inputs.test.shapes.astype(float)
    mean = inputs.scores["mean_shape"].aligned
    return {
        "n_faces": len(truth),
        "bias": {
            method: bias_of(inputs.scores[method].aligned, mean, truth)
            for method in _METHODS
            if method in inputs.scores
        },
    }


def unbiased(bias: Mapping[str, Mapping[str, float]], n_faces: int) -> Finding:
    """A face's offset from the mean comes out whole; or less is lost than by fitting a model."""
    lost = {method: 1 - own["slope"] for method, own in bias.items()}
    others = [method for method in _MODEL_BASED if method in bias]
    ours = bias["ours"]
    systematic = [f"{_percent(bias[m]['systematic_share'])} for {title(m)}" for m in others]
    evidence = (
        f"{_slopes(bias, ['ours', 'ours_stable', 'linear', *others], n_faces)} The errors of "
        f"{title('ours')} point to the mean shape with a mean cosine of {ours['cosine']:.2f}, and "
        f"its offsets correlate with the true ones by {ours['correlation']:.2f}. In statistics "
        f"errors that do not average out over faces are a bias: "
        f"{_percent(ours['systematic_share'])} of its squared error, {enumeration(systematic)}. "
        f"It uses no face model: that its networks are what draws shapes to the mean is inferred, "
        f"not shown."
    )
    if abs(lost["ours"]) <= TOLERANCE:
        return holds(evidence)
    less = [method for method in others if abs(lost["ours"]) < abs(lost[method])]
    if less:
        return holds_if(f"compared with {enumeration([*map(title, less)])}", evidence)
    if ours["systematic_share"] <= TOLERANCE:
        return holds_if("unbiased means that errors average out over faces", evidence)
    return does_not_hold(evidence)


def model_based_bias(bias: Mapping[str, Mapping[str, float]], n_faces: int) -> Finding:
    """Methods that fit a face model lose part of a face's offset from the mean."""
    methods = [method for method in _MODEL_BASED if method in bias]
    biased = [method for method in methods if 1 - bias[method]["slope"] > TOLERANCE]
    evidence = (
        f"{_slopes(bias, [*methods, 'linear', 'ours'], n_faces)} The last two use no face model. "
        f"More than {_percent(TOLERANCE)} lost counts as a bias."
    )
    if not biased:
        return does_not_hold(evidence)
    if len(biased) < len(methods):
        return holds_if(f"of {enumeration([*map(title, biased)])}", evidence)
    return holds(evidence)


def lifting_unbiased(bias: Mapping[str, Mapping[str, float]], n_faces: int) -> Finding:
    """A face's offset from the mean comes out whole, by the lifting network."""
    own = bias["lifting"]
    evidence = (
        f"{_slopes(bias, ['lifting', 'ours'], n_faces)} {_percent(own['systematic_share'])} of the "
        f"squared error of {title('lifting')} is the same for all faces. More than "
        f"{_percent(TOLERANCE)} lost counts as a bias."
    )
    return holds(evidence) if abs(1 - own["slope"]) <= TOLERANCE else does_not_hold(evidence)


def bias_of(predicted: np.ndarray, mean: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Position of predictions between mean shape and ground truth, to which both are aligned.

    Args:
        predicted, mean, truth: `(n, L, 3)`.

    Returns:
        `slope`: of the regression through the origin of predicted on true offsets from the mean,
        over all coordinates of all faces, and its standard error over faces `slope_se`. Errors
        that have nothing to do with the face leave it at 1, however large they are.
        `cosine`: between an error and the way to the mean, mean over faces; 0 where there is none.
        `systematic_share`: of the mean error over faces in the mean squared error.
        `correlation`: of predicted with true offsets; 0 where none is predicted.
    """
    n = len(truth)
    offset, predicted_offset, error = (
        difference.reshape(n, -1)
        for difference in (truth - mean, predicted - mean, predicted - truth)
    )
    products, sizes = (predicted_offset * offset).sum(1), (offset**2).sum(1)
    slope = products.sum() / sizes.sum()
    # Of a ratio of two sums over faces, to first order.
    slope_se = np.sqrt(((products - slope * sizes) ** 2).sum() * n / (n - 1)) / sizes.sum()
    lengths = np.linalg.norm(error, axis=1) * np.sqrt(sizes)
    cosine = _ratio(-(error * offset).sum(1), lengths)
    spread = np.sqrt((predicted_offset**2).sum() * sizes.sum())
    return {
        "slope": float(slope),
        "slope_se": float(slope_se),
        "cosine": float(cosine.mean()),
        "systematic_share": float(_ratio((error.mean(0) ** 2).sum(), (error**2).sum(1).mean())),
        "correlation": float(_ratio(products.sum(), spread)),
    }


def _ratio(part, whole) -> np.ndarray:
    """Elementwise, 0 where the whole is 0."""
    return np.divide(part, whole, out=np.zeros_like(whole), where=np.asarray(whole) > 0)


def _slopes(bias: Mapping, methods: list[str], n_faces: int) -> str:
    slopes = [
        f"{plus_minus(bias[m]['slope'], bias[m]['slope_se'])} for {title(m)}" for m in methods
    ]
    return (
        f"A part of a face's offset from the mean training shape is found again: 1 is unbiased, 0 "
        f"always the mean shape. Over {n_faces:,} test faces it is {enumeration(slopes)}."
    )


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"
