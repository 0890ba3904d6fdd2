"""Step: train every method on views of an object from one seed, and score it on held-out shapes."""

import numpy as np
import pandas as pd

from deepmds_keras.baselines.closed_form import MeanShape, RidgeRegression
from deepmds_keras.baselines.map_fit import MapFit, principal_components
from deepmds_keras.baselines.mlp import MLP
from deepmds_keras.deep_mds import DeepMDS
from deepmds_keras.geometry.alignment import align
from deepmds_keras.geometry.units import normalise
from deepmds_keras.lifting.lifter import LandmarkLifter
from experiments.objects.shapes import METHODS, NOISES, Views, scores_file, views_of
from experiments.recipes import deep_mds, fit
from experiments.records import write_csv
from experiments.run import Run

_UNITS = 256  # of each hidden layer of the MLP
_ORTHOGRAPHIC = 0.0, 1e-3  # perspective of the views, mean and s.d.
_LEAST_SD = 1e-3  # of a component, in r.m.s. radii


def main(run: Run, name: str, seed: str) -> None:
    rows = []
    for noise in NOISES:
        train, test = views_of(run, name, int(seed), noise)
        for method in METHODS:
            shapes, more = predicted(run, method, int(seed), noise, train, test)
            error = errors(shapes, test.shapes).mean()
            where = {"object": name, "noise": noise, "method": method, "seed": int(seed)}
            size = {"n_landmarks": shapes.shape[1], "n_views": len(shapes)}
            rows.append(where | {"error": error} | more | size)
    write_csv(scores_file(run, name, int(seed)), pd.DataFrame(rows))


def errors(shapes: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Mean squared distance of a landmark after alignment with scale and reflection, `(n,)`.

    Its unit is the squared r.m.s. radius, which is 1 for the true shapes.
    """
    return np.mean(np.sum((align(shapes, truth) - truth) ** 2, axis=2), axis=1)


def predicted(
    run: Run, method: str, seed: int, noise: float, train: Views, test: Views
) -> tuple[np.ndarray, dict[str, float]]:
    """Shapes of the test views by a method trained on the others, and what else is measured."""
    n_landmarks, n_steps = train.views.shape[1], run.preset.lifting_steps // 2
    if method == "map_learnt":
        model = MapFit(*principal_components(train.shapes, _LEAST_SD), perspective=_ORTHOGRAPHIC)
        return model.predict(test.views, noise), {}
    if method == "landmark_lifter":
        lifter = LandmarkLifter(n_landmarks, steps=n_steps, seed=seed)
        fit(lifter, train.views, train.shapes, landmark_sd=noise)
        return lifter.predict(test.views, landmark_sd=noise), {}
    if method == "deep_mds":
        model = deep_mds(run, "paper", "constant").set_params(
            n_landmarks=n_landmarks, centre_views=True, seed=seed, solver="numba"
        )
        fit(model, train.views, train.shapes)
        return model.predict(test.views), {"frontal_share": frontal_share(model, train, test)}
    if method == "mlp":
        steps = -(-n_steps // MLP.epochs)
        model = MLP(n_landmarks, units=_UNITS, steps_per_epoch=steps, seed=seed)
        fit(model, train.views, train.shapes)
    else:
        model = MeanShape() if method == "mean_shape" else RidgeRegression()
        model.fit(train.views, train.shapes)
    return model.predict(test.views), {}


def frontal_share(model: DeepMDS, train: Views, test: Views) -> float:
    """Squared error of the autoencoder's frontal views, in that of the mean frontal view.

    1 is an autoencoder that gives the same view for all, above 1 it does worse.
    """
    target, mean = normalise(test.shapes)[..., :2], normalise(train.shapes)[..., :2].mean(0)
    off = model.frontalise(test.views) - target
    return float(np.mean(off**2) / np.mean((mean - target) ** 2))
