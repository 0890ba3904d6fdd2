"""Calibration: how many true coordinates lie as near as their predicted s.d. says."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

# Probability of the intervals of one and two s.d. about a prediction.
WITHIN = {2 * norm.cdf(n) - 1: f"within_{n}_sd" for n in (1, 2)}
NOMINAL = np.sort([*np.arange(1, 20) / 20, *WITHIN])


def coverage(errors: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Share of each face's coordinates within the intervals of `NOMINAL`, `(n, levels)`.

    Args:
        errors: `(n, L, 3)` of the coordinates.
        sd: `(n, L, 3)` predicted standard deviations, of normal errors.
    """
    certainty = 2 * norm.cdf(np.abs(errors) / sd) - 1
    return np.stack([(certainty <= level).mean((1, 2)) for level in NOMINAL], 1)
