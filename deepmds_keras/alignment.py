"""Procrustes alignment of one set of landmarks onto another, for many faces at once."""

from __future__ import annotations

import numpy as np

from deepmds_keras.io.errors import InputError


def align(
    source: np.ndarray, target: np.ndarray, *, scaling: bool = True, reflection: bool = True
) -> np.ndarray:
    """Map each source onto its target by the best rotation, translation and scale.

    The least-squares solution of Gower 1975 (doi:10.1007/BF02291478) and Schönemann 1966
    (doi:10.1007/BF02289451). The paper names rotation, translation and scale; its released
    evaluation calls MATLAB's `procrustes`, which allows a reflection too, so that a face turned
    inside out scores a perfect zero. That is the default here, for comparison with the published
    numbers; `is_mirrored` counts how often it was needed.

    Args:
        source: `(n, L, d)` or `(L, d)` points to move.
        target: Points of the same shape; a single `(L, d)` target serves all sources.
        scaling: Whether the source may be scaled.
        reflection: Whether it may be mirrored.

    Returns:
        The moved source, of the source's shape.

    Raises:
        InputError: Shapes that do not match, NaN or infinity.
    """
    source, target = _check(source, target)
    source_centre = source.mean(-2, keepdims=True)
    target_centre = target.mean(-2, keepdims=True)
    centred = source - source_centre
    u, singular, vt = _svd(centred, target - target_centre)
    if not reflection:
        singular, vt = singular.copy(), vt.copy()
        sign = np.sign(np.linalg.det(u @ vt))
        singular[..., -1] *= sign
        vt[..., -1, :] *= sign[..., None]
    moved = centred @ (u @ vt)
    if scaling:
        size = (centred**2).sum((-2, -1))
        moved = moved * (singular.sum(-1) / np.where(size > 0, size, 1))[..., None, None]
    return moved + target_centre


def is_mirrored(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Whether the best orthogonal map of each source onto its target is a reflection: `(n,)`."""
    source, target = _check(source, target)
    u, _, vt = _svd(
        source - source.mean(-2, keepdims=True), target - target.mean(-2, keepdims=True)
    )
    return np.linalg.det(u @ vt) < 0


def _svd(source, target):
    return np.linalg.svd(np.swapaxes(source, -1, -2) @ target)


def _check(source, target):
    source, target = np.asarray(source, float), np.asarray(target, float)
    if source.ndim not in (2, 3) or source.shape[-2:] != target.shape[-2:]:
        raise InputError(
            "source and target must have the same shape (n, L, d) or (L, d). "
            f"Received {source.shape} and {target.shape}."
        )
    if target.ndim == 3 and source.shape != target.shape:
        raise InputError(
            f"target must be one face or one for each source. Received {target.shape[0]} "
            f"targets for sources of shape {source.shape}."
        )
    if not (np.isfinite(source).all() and np.isfinite(target).all()):
        raise InputError("source and target must be finite. Received NaN or infinity.")
    return source, target
