"""Procrustes alignment of one set of landmarks onto another."""

from typing import NamedTuple

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.geometry.units import centre, rescaled
from deepmds_keras.validation import as_numbers

_ROUNDS = 10  # of `align_to_mean`, after which the mean no longer turns


class Similarity(NamedTuple):
    """`source * scale @ rotation + translation`, of one set of points or of each of many.

    Attributes:
        rotation: `(..., d, d)` orthogonal, to be multiplied from the right.
        scale: `(...)`.
        translation: `(..., d)`.
    """

    rotation: np.ndarray
    scale: np.ndarray
    translation: np.ndarray


def procrustes(
    source: np.ndarray, target: np.ndarray, *, scaling: bool = True, reflection: bool = True
) -> Similarity:
    """Return the similarity that brings each source nearest to its target in least squares.

    Gower 1975 (doi:10.1007/BF02291478), Schönemann 1966 (doi:10.1007/BF02289451); without
    reflection Umeyama 1991 (doi:10.1109/34.88573).

    Arguments and errors are those of `align`.
    """
    source, target = as_numbers(source, "source"), as_numbers(target, "target")
    shape, of_face = source.shape, source.shape[-2:]
    if source.ndim not in (2, 3) or 0 in of_face or target.shape not in (shape, of_face):
        raise InputError(
            "source must have shape (n, L >= 1, d) or (L, d), and target the same shape or that of "
            f"one face. Received {shape} and {target.shape}."
        )
    if not (np.isfinite(source).all() and np.isfinite(target).all()):
        raise InputError("source and target must be finite. Received NaN or infinity.")
    source_centre, target_centre = source.mean(-2), target.mean(-2)
    centred, of_source = rescaled(source - source_centre[..., None, :])
    wanted, of_target = rescaled(centre(target))
    u, singular, vt = np.linalg.svd(np.swapaxes(centred, -1, -2) @ wanted)
    if not reflection:
        singular, vt = singular.copy(), vt.copy()
        sign = np.sign(np.linalg.det(u @ vt))
        singular[..., -1] *= sign
        vt[..., -1, :] *= sign[..., None]
    rotation, scale = u @ vt, np.ones(centred.shape[:-2])
    if scaling:
        size = (centred**2).sum((-2, -1))
        scale = singular.sum(-1) / np.where(size > 0, size, 1)
        scale = np.ldexp(scale, (of_target - of_source)[..., 0, 0])
    moved = (source_centre[..., None, :] @ rotation)[..., 0, :]
    return Similarity(rotation, scale, target_centre - scale[..., None] * moved)


def align(
    source: np.ndarray, target: np.ndarray, *, scaling: bool = True, reflection: bool = True
) -> np.ndarray:
    """Map each source onto its target by the best rotation, translation and scale.

    The paper names these three; its released evaluation calls MATLAB's `procrustes`, which allows
    a reflection too, so that a face turned inside out scores a perfect zero. That is the default
    here, for comparison with the published numbers; `is_mirrored` shows where it was needed.

    Args:
        source: `(n, L, d)` or `(L, d)` points to move.
        target: Points of the same shape; a single `(L, d)` target serves all sources.
        scaling: Whether the source may be scaled.
        reflection: Whether it may be mirrored.

    Returns:
        The moved source, of the source's shape.

    Raises:
        InputError: Shapes that do not match, NaN, infinity or masked numbers.
    """
    rotation, scale, _ = procrustes(source, target, scaling=scaling, reflection=reflection)
    middle = np.asarray(target, float).mean(-2, keepdims=True)
    return centre(source) @ rotation * scale[..., None, None] + middle


def align_to_mean(shapes: np.ndarray, n_known: int, *, upright: bool = False) -> np.ndarray:
    """Turn each shape onto the mean of the first `n_known`: generalised Procrustes analysis.

    Gower 1975 (doi:10.1007/BF02291478), without scale or reflection. Where views are from all
    sides, which way a shape faced is variance that no view shows.

    Args:
        shapes: `(n, L, 3)`, centred.
        n_known: How many of them make the mean; those of the training.
        upright: Whether to turn about the vertical (y) alone.

    Returns:
        The turned shapes, `(n, L, 3)`.
    """
    axes = [0, 2] if upright else slice(None)
    turned, mean = shapes.copy(), shapes[0]
    for _ in range(_ROUNDS):
        turned[..., axes] = align(turned[..., axes], mean[:, axes], scaling=False, reflection=False)
        mean = turned[:n_known].mean(0)
    return turned


def is_mirrored(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Whether the best orthogonal map of each source onto its target is a reflection: `(n,)`."""
    return np.linalg.det(procrustes(source, target).rotation) < 0
