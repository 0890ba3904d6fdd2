"""A reviewer's question: what errors of a landmark detector do to each method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import sem

from deepmds_keras.landmarks import LandmarkScheme
from deepmds_keras.normalisation import normalise
from experiments.audit.evidence import Inputs
from experiments.audit.findings import ALIKE, Finding, does_not_hold, holds, holds_if
from experiments.inputs import Faces
from experiments.methods import title
from experiments.scoring.numbers import enumeration, factor, scientific
from experiments.scoring.scores import score
from experiments.streams import Stream

# Standard deviations of each coordinate, in percent of the distance of the outer corners of the
# eyes, in which the errors of landmark detectors are given.
PERCENTS = (0, 0.5, 1, 2, 3, 4, 5)
_METHODS = ("mean_shape", "linear", "zhao", "aldrian", "ours", "ours_stable")
_SWEEP = "noise_percent"
_DRAWS = 3  # of the errors of each face, over which its MSE is averaged


def measure(inputs: Inputs) -> dict:
    """`curves`: errors of the audited test faces by the noise on their landmarks."""
    rng = np.random.default_rng([inputs.run.seed, Stream.AUDIT_NOISE])
    dataset, test = inputs.test_dataset, inputs.test[inputs.audited]
    views = dataset.views[inputs.audited].astype(float)
    distances = interocular_distances(dataset.landmarks[inputs.audited], inputs.scheme)
    # The same errors at every size, so that a curve shows nothing but the size.
    errors = distances[:, None, None] * rng.standard_normal((_DRAWS, *views.shape))
    noisy = {p: normalise(views + p / 100 * (errors if p else errors[:1])) for p in PERCENTS}
    curves = []
    for method in (*_METHODS, *["authors_weights"] * (inputs.run.authors is not None)):
        for percent, own in noisy.items():
            mse = mean_errors(inputs.method(method), own, test)
            row = {"sweep": _SWEEP, "value": percent, "method": method, "mse": float(mse.mean())}
            curves.append(row | {"sem": float(sem(mse))})
    return {"n_faces": len(views), "curves": curves}


def withstands(
    curves: Sequence[Mapping], n_faces: int, interocular_percent: float, alike: float = ALIKE
) -> Finding:
    """Up to which noise does the error stay like that without?"""
    errors: dict[str, dict[float, float]] = {}
    for row in curves:
        errors.setdefault(row["method"], {})[row["value"]] = row["mse"]
    ours, mean_shape = errors["ours"], errors["mean_shape"]
    percents = [percent for percent in sorted(ours) if percent <= interocular_percent]
    last = percents[-1]
    broken = [percent for percent in percents if ours[percent] > alike * ours[0]]
    reach = max(percent for percent in percents if not broken or percent < broken[0])
    others = [
        f"{title(method)} {factor(own[last] / own[0])} times, to {scientific(own[last], 3)}"
        for method, own in errors.items()
        if method not in ("ours", "mean_shape")
    ]
    worse = [percent for percent in percents if ours[percent] > mean_shape[percent]]
    evidence = (
        f"Each coordinate of a landmark of {n_faces} test faces has a Gaussian error of {last:g} % "
        f"of the interocular distance. That raises the MSE of {title('ours')} "
        f"{factor(ours[last] / ours[0])} times, from {scientific(ours[0], 3)} to "
        f"{scientific(ours[last], 3)}; that of {enumeration(others)}. The mean shape has "
        f"{scientific(mean_shape[last], 3)} whatever the view; {title('ours')} is "
        + (f"worse than it from {worse[0]:g} % on." if worse else "better at every size.")
    )
    if reach >= interocular_percent:
        return holds(evidence)
    if reach > 0:
        return holds_if(f"up to {reach:g} % of the interocular distance", evidence)
    return does_not_hold(evidence)


def mean_errors(model, views: np.ndarray, test: Faces) -> np.ndarray:
    """MSE of each face, averaged over draws of its view: `(draws, n, L, 2)` → `(n,)`."""
    n_draws, n, *_ = views.shape
    shapes = model.predict(views.reshape(-1, *views.shape[2:]))
    return score(shapes, test[np.tile(np.arange(n), n_draws)]).mse.reshape(n_draws, n).mean(0)


def interocular_distances(landmarks: np.ndarray, scheme: LandmarkScheme) -> np.ndarray:
    """Distance of the outer corners of the eyes of each face: `(n, L, 3)` → `(n,)`."""
    right, left = (scheme.names.index(f"{side}_eye_outer_corner") for side in ("right", "left"))
    return np.linalg.norm(landmarks[:, right].astype(float) - landmarks[:, left], axis=-1)
