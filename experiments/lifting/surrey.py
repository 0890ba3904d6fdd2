"""The Surrey Face Model at the landmarks of the inner face: test faces unlike any in training.

Huber et al. 2016, doi:10.5220/0005669500580067, from scans of 169 people; for non-commercial
research, from https://github.com/patrikhuber/eos/tree/master/share.
"""

from pathlib import Path

import numpy as np

from deepmds_keras.baselines.eos_fit import NUMBERS, read_surrey
from deepmds_keras.landmarks import load_scheme

# Largest weight of each of the six expressions; with all of them at 1, faces are contorted.
_MOST_EXPRESSION = 0.5


def sample_surrey(path: str | Path, n: int, rng: np.random.Generator) -> np.ndarray:
    """Landmarks `ibug51` of random expressive faces, with standard-normal identities.

    Args:
        path: eos's folder `share`, or its file `sfm_shape_3448.bin`.

    Returns:
        `(n, 51, 3)` millimetres, +x to the subject's left, +y up, +z out of the face, NaN at the
        two that the model lacks.

    Raises:
        InputError: eos-py is missing, or a file is missing or damaged.
    """
    _, shape, blendshapes, _, vertices = read_surrey(path)
    # Rows of a flat mesh: three per vertex.
    rows = (3 * np.array(vertices)[:, None] + range(3)).ravel()
    of_identity = np.array(shape.get_rescaled_pca_basis())[rows].T
    of_expression = np.stack([np.ravel(b.deformation)[rows] for b in blendshapes])
    identity = rng.standard_normal((n, len(of_identity)))
    expression = _MOST_EXPRESSION * rng.random((n, len(of_expression)))
    flat = np.ravel(shape.get_mean())[rows] + identity @ of_identity + expression @ of_expression
    shapes = np.full((n, len(load_scheme("ibug51")), 3), np.nan)
    shapes[:, np.isin(load_scheme("ibug51").numbers, NUMBERS)] = flat.reshape(n, -1, 3)
    return shapes
