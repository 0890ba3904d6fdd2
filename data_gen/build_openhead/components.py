"""From random heads to a linear model: rigid alignment, principal components, expressions."""

from __future__ import annotations

import numpy as np
from sklearn.utils.extmath import randomized_svd

from data_gen.build_openhead.cut import Head
from data_gen.build_openhead.makehuman import MakeHumanAssets
from deepmds_keras.alignment import procrustes

N_COMPONENTS = 199  # as many as the Basel Face Model has
ALIGNMENT_ROUNDS = 4
CHUNK = 1000
NOSE_TIP = 28  # landmark 29 of bfm72
NOSE_TIP_POSITION = np.array([0.0, 4.4, 131.0])  # mm; where the Basel Face Model has it


def align_rigidly(heads: np.ndarray, head: Head, progress=iter) -> np.ndarray:
    """Rotates and shifts the heads, in place, onto their mirror-symmetric mean.

    Only the face counts for the fit (least squares), not crown, ears and neck.

    Returns:
        `(V, 3)` float64 mean.
    """
    face = np.flatnonzero(head.masks["face"] > 0.5)
    mean = _symmetric_mean(heads, head)
    for _ in progress(range(ALIGNMENT_ROUNDS)):
        for start in range(0, len(heads), CHUNK):
            chunk = heads[start : start + CHUNK]
            rotation, _, _ = procrustes(chunk[:, face], mean[face], scaling=False)
            chunk[:] = (chunk - chunk[:, face].mean(1, keepdims=True)) @ rotation
        mean = _symmetric_mean(heads, head)
    return mean


def principal_components(
    heads: np.ndarray, mean: np.ndarray, head: Head, n_components: int = N_COMPONENTS
) -> np.ndarray:
    """`(n_components, V, 3)` offsets in mm at one s.d., of the heads and their mirror images.

    Adding the mirror image of every head splits the covariance exactly into that of the symmetric
    halves and that of the antisymmetric halves of the deviations. Each is decomposed for itself
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


def expressions(assets: MakeHumanAssets, head: Head) -> tuple[list[str], np.ndarray]:
    """Names of the face units and their `(E, V, 3)` offsets in mm at full strength.

    `tongueOut` is left out: the head has no tongue, so nothing of it would move.
    """
    names = [name for name in assets.face_unit_names() if name != "tongueOut"]
    return names, np.array([head.restrict(assets.face_unit(name)) for name in names])


def place_origin(mean: np.ndarray, head: Head) -> np.ndarray:
    """The mean shifted so that its nose tip is where the Basel Face Model has it."""
    return mean + NOSE_TIP_POSITION - mean[head.landmarks["bfm72"][NOSE_TIP]]


def _symmetric_mean(heads: np.ndarray, head: Head) -> np.ndarray:
    mean = heads.mean(0, dtype=np.float64)
    return (mean + head.reflect(mean)) / 2
