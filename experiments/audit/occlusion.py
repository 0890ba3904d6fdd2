"""Landmarks that are not seen: those that the head itself hides, and those missing at random."""

from __future__ import annotations

import numpy as np

from data_gen.projections import Cameras, in_camera_frame, project_with_depth
from deepmds_keras.normalisation import normalise
from experiments.audit.findings import ALIKE, Finding, does_not_hold, holds, holds_if
from experiments.audit.inputs import Inputs
from experiments.audit.poses import FRONTAL, WITHOUT, kinds, without_autoencoder
from experiments.inputs import Faces
from experiments.methods import title
from experiments.numbers import enumeration, factor, minus, scientific
from experiments.run import one_core
from experiments.scores import score

PERCENTAGES = (0, 5, 10, 20, 30)
# Ways to fill in what is missing: where the landmark is on average in the training views, or where
# it is expected, given those that are seen.
FILLS = ("mean", "regression")
_METHODS = ("linear", "ours", "ours_stable")
_POSED_FACES = 60  # whose whole meshes are looked at
_FACES_THINNED = 100  # of the audited faces
# Millimetres behind the surface from which a landmark is hidden: deeper than folds of the skin
# that a person marks as if they were seen.
_BEHIND = 2.0
# Standard deviation by which landmarks that are seen are trusted. Those of the data sets are exact,
# which a regression would exploit as no real view allows.
_SEEN_SD_MM = 1.0
_MISSING = 5  # stream of random numbers beside those of the audit's other topics


def measure(inputs: Inputs) -> dict:
    """Numbers of hidden landmarks, and errors once such and random ones are filled in."""
    models = {method: inputs.method(method) for method in _METHODS}
    models[WITHOUT] = without_autoencoder(models["ours"])
    fillers = _fillers(inputs.train_dataset.views)
    frontal = kinds(inputs.test.cameras).get(FRONTAL, np.zeros(len(inputs.test.views), bool))
    posed = inputs.audited[~frontal[inputs.audited]][:_POSED_FACES]
    hidden = _hidden(inputs, posed)
    turned = inputs.test_dataset.views[posed].astype(float)
    errors = {
        fill: _errors(models, fillers[fill](turned, hidden), inputs.test[posed])
        for fill in ("none", *FILLS)
    }
    thinned = inputs.audited[:_FACES_THINNED]
    curves = _thinned(
        models,
        fillers,
        inputs.test_dataset.views[thinned].astype(float),
        inputs.test[thinned],
        np.random.default_rng([inputs.run.seed, _MISSING]),
    )
    return {
        "curves": curves,
        "n_landmarks": len(inputs.scheme),
        "hidden_by_kind": _mean_hidden(inputs, posed, hidden),
        "faces_posed": len(posed),
        "faces_thinned": len(thinned),
        "occluded": {
            fill: {method: float(mse.mean()) for method, mse in own.items()}
            for fill, own in errors.items()
        },
        "thinned": {
            fill: {
                row["value"]: row["mse"]
                for row in curves
                if row["method"] == "ours" and row["sweep"] == _sweep(fill)
            }
            for fill in FILLS
        },
    }
