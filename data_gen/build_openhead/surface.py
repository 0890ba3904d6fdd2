"""A small form of the open head, to fit its surface to landmarks: `deepmds predict --mesh`.

The joint Gaussian of all vertices under identities and expressions, landmarks among them, by its
first principal components. `python -m experiments surface` writes it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from data_gen.models.morphable_model import MorphableModel
from data_gen.models.openhead import load_openhead, read_openhead
from data_gen.views.photo_views import sample_expressive
from deepmds_keras.files import atomic_write

RANK = 48  # more gain nothing: 32 lose 0.03 mm
_EXPRESSIONS, _SEED = 20_000, 1
_FACE, _REST = 3.0, 1.0  # how much a vertex of either counts in the components
_MOST = 127  # of an int8


def write_surface(path: str | Path) -> None:
    """Write the model, complete or not at all.

    `mean` `(V, 3)` float32, mm; `basis` `(RANK, V, 3)` int8 and `scale` `(RANK,)` float32, of which
    the product is what one standard deviation adds; `triangles` `(T, 3)` and, by scheme,
    `landmarks_ibug51` … `(L,)` uint16.

    Raises:
        OSError: It cannot be written.
    """
    head = load_openhead()
    mean, basis = _components(head)
    scale = np.abs(basis).max((1, 2)) / _MOST
    arrays = {
        "mean": np.float32(mean),
        "basis": np.round(basis / scale[:, None, None]).astype(np.int8),
        "scale": np.float32(scale),
        "triangles": head.triangles.astype(np.uint16),
    }
    arrays |= {f"landmarks_{name}": v.astype(np.uint16) for name, v in head.landmarks.items()}
    with atomic_write(path) as file:
        np.savez_compressed(file, **arrays)


def _components(head: MorphableModel) -> tuple[np.ndarray, np.ndarray]:
    """Mean `(V, 3)` and principal components `(RANK, V, 3)`, times their standard deviations."""
    _, weights = sample_expressive(head, _EXPRESSIONS, np.random.default_rng(_SEED))
    variances, axes = np.linalg.eigh(np.cov(weights.T))
    moves = np.tensordot((axes * np.sqrt(variances.clip(0))).T, head.expression_basis, 1)
    factors = np.concatenate([head.identity_basis_times_sd, moves])
    arrays = read_openhead()
    counts = np.where((arrays["mask_face"] > _MOST) | (arrays["part"] > 0), _FACE, _REST)
    flat = (factors * counts[:, None]).reshape(len(factors), -1)
    _, rotation = np.linalg.eigh(flat @ flat.T)
    mean = head.mean + np.tensordot(weights.mean(0), head.expression_basis, 1)
    return mean, np.tensordot(rotation[:, : -RANK - 1 : -1].T, factors, 1)
