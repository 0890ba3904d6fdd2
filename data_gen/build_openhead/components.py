"""From random heads to a linear model, and from that to the small one of `deepmds predict --mesh`.

The latter is the joint Gaussian of all vertices under identities and expressions, landmarks among
them, by its first principal components. `python -m experiments surface` writes it.
"""

from pathlib import Path

import numpy as np
from sklearn.utils.extmath import randomized_svd

from data_gen.build_openhead.cut import Head
from data_gen.models.morphable_model import MorphableModel
from data_gen.models.openhead import load_openhead, read_openhead
from data_gen.views import sample_expressive
from deepmds_keras.files import atomic_write
from deepmds_keras.geometry.alignment import procrustes

N_COMPONENTS = 199  # as many as the Basel Face Model has
RANK = 48  # of the small model; more gain nothing: 32 lose 0.03 mm
_ROUNDS, _CHUNK = 4, 1000
_EXPRESSIONS, _SEED = 20_000, 1
_FACE, _REST = 3.0, 1.0  # how much a vertex of either counts in the components
_MAX_INT8 = 127


def align_rigidly(heads: np.ndarray, head: Head, progress=iter) -> np.ndarray:
    """Rotates and shifts the heads, in place, onto their mirror-symmetric mean.

    Only the face counts for the fit (least squares), not crown, ears and neck.

    Returns:
        `(V, 3)` float64 mean.
    """
    face = np.flatnonzero(head.masks["face"] > 0.5)
    mean = _symmetric_mean(heads, head)
    for _ in progress(range(_ROUNDS)):
        for start in range(0, len(heads), _CHUNK):
            chunk = heads[start : start + _CHUNK]
            rotation, _, _ = procrustes(chunk[:, face], mean[face], scaling=False)
            chunk[:] = (chunk - chunk[:, face].mean(1, keepdims=True)) @ rotation
        mean = _symmetric_mean(heads, head)
    return mean


def principal_components(
    heads: np.ndarray, mean: np.ndarray, head: Head, n_components: int = N_COMPONENTS
) -> np.ndarray:
    """`(n_components, V, 3)` offsets in mm at one s.d., of the heads and their mirror images.

    Adding the mirror image of every head splits the covariance exactly into that of the symmetric
    halves and that of the antisymmetric halves of the deviations. Each is decomposed separately
    (half the memory, and each component is exactly one or the other), then they are merged.
    """
    n, n_vertices = heads.shape[:2]
    bases = []
    for sign in (1, -1):
        half = heads - mean.astype(np.float32)
        half = (half + sign * head.reflect(half)) / 2
        # QR between the power iterations, or float32 would lose the small components.
        _, singular, basis = randomized_svd(
            half.reshape(n, -1),
            n_components,
            n_oversamples=60,
            n_iter=4,
            power_iteration_normalizer="QR",
            random_state=0,
        )
        basis = (basis * (singular / np.sqrt(n))[:, None]).reshape(-1, n_vertices, 3)
        bases.append((basis + sign * head.reflect(basis)) / 2)
    basis = np.concatenate(bases)
    strongest = np.argsort(-np.linalg.norm(basis, axis=(1, 2)), kind="stable")
    return basis[strongest[:n_components]]


def _symmetric_mean(heads: np.ndarray, head: Head) -> np.ndarray:
    mean = heads.mean(0, dtype=np.float64)
    return (mean + head.reflect(mean)) / 2


def write_surface(path: str | Path) -> None:
    """Write the small model, complete or not at all.

    `mean` `(V, 3)` float32, mm; `basis` `(RANK, V, 3)` int8 and `scale` `(RANK,)` float32, of which
    the product is what one standard deviation adds; `triangles` `(T, 3)` and, by scheme,
    `landmarks_ibug51` … `(L,)` uint16.

    Raises:
        OSError: It cannot be written.
    """
    head = load_openhead()
    mean, basis = _small_model(head)
    scale = np.abs(basis).max((1, 2)) / _MAX_INT8
    arrays = {
        "mean": np.float32(mean),
        "basis": np.round(basis / scale[:, None, None]).astype(np.int8),
        "scale": np.float32(scale),
        "triangles": head.triangles.astype(np.uint16),
    }
    arrays |= {f"landmarks_{name}": v.astype(np.uint16) for name, v in head.landmarks.items()}
    with atomic_write(path) as file:
        np.savez_compressed(file, **arrays)


def _small_model(head: MorphableModel) -> tuple[np.ndarray, np.ndarray]:
    """Mean `(V, 3)` and principal components `(RANK, V, 3)`, times their standard deviations."""
    _, weights = sample_expressive(head, _EXPRESSIONS, np.random.default_rng(_SEED))
    variances, axes = np.linalg.eigh(np.cov(weights.T))
    moves = np.tensordot((axes * np.sqrt(variances.clip(0))).T, head.expression_basis, 1)
    factors = np.concatenate([head.identity_basis_times_sd, moves])
    arrays = read_openhead()
    counts = np.where((arrays["mask_face"] > 127) | (arrays["part"] > 0), _FACE, _REST)
    flat = (factors * counts[:, None]).reshape(len(factors), -1)
    _, rotation = np.linalg.eigh(flat @ flat.T)
    mean = head.mean + np.tensordot(weights.mean(0), head.expression_basis, 1)
    return mean, np.tensordot(rotation[:, : -RANK - 1 : -1].T, factors, 1)
