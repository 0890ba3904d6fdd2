"""Remarks that a reader of a table needs on a method in this run, beside what its row says.

Functions of the run, and of `(n,)` bool: whether the method found each test face.
"""

from __future__ import annotations

import numpy as np

from experiments.inputs import load_landmark_model
from experiments.recipes import LIFTING_NOISE, mobileface_recipe
from experiments.run import Run

_RATES = {"cosine": "learning rate that decays to 0", "constant": "constant learning rate"}


def of_mobileface(run: Run, found: np.ndarray) -> str:
    if run.track == "celeba":
        return "trained on renders before an empty background, as on the BFM track"
    schedule, epochs = mobileface_recipe(run)
    return (
        f"trained for {epochs * run.preset.mobileface_steps:,} steps of 16 images at a "
        f"{_RATES[schedule]} (the released code: 100,000 at a constant one) to find "
        f"{len(load_landmark_model(run)[1])} coefficients of the face model"
    )


def of_ringnet(run: Run, found: np.ndarray) -> str:
    if run.ringnet is not None:
        return ""
    steps = run.preset.ringnet_epochs * run.preset.ringnet_steps
    return (
        f"retrained, {steps:,} steps, from random weights on renders of the face model; the "
        "paper's is the published one"
    )


def of_lifting(run: Run, found: np.ndarray) -> str:
    said = f"not in the paper; trained for {run.preset.lifting_steps:,} steps of 128 faces"
    if run.track == "flame":
        said += (
            ", with errors added to the landmarks, of a s.d. of up to "
            f"{100 * LIFTING_NOISE:g} % of a view's r.m.s. radius, since a detector finds those "
            "of the test; other methods learn from exact ones"
        )
    return said


def of_mediapipe(run: Run, found: np.ndarray) -> str:
    lost = int((~found).sum())
    return f"no face found in {lost:,} of {len(found):,} photos (N/A), which are left out"


def of_model_fit(run: Run, found: np.ndarray) -> str:
    if run.track == "flame":
        return ""
    return "no method here: what the paper takes for the truth, scored against the true one"
