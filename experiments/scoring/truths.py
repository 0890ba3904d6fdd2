"""The test faces with another truth than the one of the paper's pipeline."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from deepmds_keras.normalisation import normalise, unit
from experiments.inputs import Faces


def against(test: Faces, landmarks: np.ndarray) -> Faces:
    """The test faces with other landmarks, `(n, L, 3)` millimetres, for their truth."""
    return replace(
        test, shapes=np.float32(normalise(landmarks)), unit_mm=unit(landmarks)[1].ravel()
    )
