"""The criteria of the paper's tables."""

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.geometry.alignment import align
from deepmds_keras.geometry.units import centre_and_scale, rescaled
from deepmds_keras.validation import as_numbers

_ROUNDING = 1e-12  # Relative spread below which numbers count as constant.


def mse(prediction: np.ndarray, truth: np.ndarray) -> np.ndarray | float:
    """Mean of the squared differences over all coordinates of a face.

    The paper prints a sum of absolute differences; its code takes the mean of the squares.

    Args:
        prediction, truth: `(n, L, 3)` or `(L, 3)`, aligned, in the same unit.

    Returns:
        `(n,)`, or a float for one face, in that unit squared.

    Raises:
        InputError: The arrays' shapes differ or are not those of faces, or a number is not finite.
    """
    prediction, truth = _pair(prediction, truth)
    return np.mean((prediction - truth) ** 2, axis=(-2, -1))


def explained_share(prediction: np.ndarray, truth: np.ndarray) -> float:
    """Share of the variance of the true shapes that the predicted ones explain, R².

    It is 1 minus the ratio of the mean squared error to that of the mean true shape, both aligned
    to each face with scale and reflection: 1 at best, 0 for the mean shape.

    Args:
        prediction, truth: `(n, L, 3)`, n at least 2, any scale.

    Raises:
        InputError: As for `mse`, or fewer than two faces, or true ones that do not differ.
    """
    prediction, truth = _pair(prediction, truth, least=2)
    truth = centre_and_scale(truth)
    mean = np.broadcast_to(truth.mean(0), truth.shape)
    error, worst = (np.mean(mse(align(x, truth), truth)) for x in (prediction, mean))
    if worst < _ROUNDING**2:
        raise InputError("truth must have faces that differ. Received one shape for all.")
    return float(1 - error / worst)


def depth_corr(prediction: np.ndarray, truth: np.ndarray) -> np.ndarray | float:
    """Trace of the correlation matrix of the predicted and the true landmarks of a face.

    Each landmark contributes the Pearson correlation of its three predicted with its three true
    coordinates, as in the released code; L at most. It depends on where the origin lies and is
    close to L for anything near the face. A landmark of three equal coordinates contributes 0.
    Arguments, shape of the result and errors are those of `mse`.
    """
    prediction, truth = _pair(prediction, truth)
    return _pearson(prediction, truth, axis=-1).sum(axis=-1)


def depth_corr_across_faces(prediction: np.ndarray, truth: np.ndarray) -> float:
    """Sum over landmarks of the absolute correlation, across faces, of predicted with true depth.

    Moniz et al. 2018, "Unsupervised Depth Estimation, 3D Face Rotation and Replacement", which the
    paper cites for its own criterion. L at most; a landmark whose depth does not vary contributes
    0, so that a constant answer scores 0. Once aligned to each face it is no longer constant:
    Procrustes gives it the position and size of the truth, and it scores high. Arguments and errors
    are those of `explained_share`, but aligned, and faces may be equal.
    """
    prediction, truth = _pair(prediction, truth, least=2)
    return float(np.abs(_pearson(prediction[..., 2], truth[..., 2], axis=0)).sum())


def _pair(prediction, truth, least: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Both as checked arrays of floats, with at least that many faces."""
    prediction, truth = as_numbers(prediction, "prediction"), as_numbers(truth, "truth")
    shape = prediction.shape
    if shape != truth.shape:
        raise InputError(
            f"prediction and truth must have the same shape. Received {shape} and {truth.shape}."
        )
    if len(shape) not in (2, 3) or shape[-1] != 3 or 0 in shape:
        raise InputError(f"prediction must have shape (n, L, 3) or (L, 3). Received {shape}.")
    if least and (len(shape) != 3 or shape[0] < least):
        raise InputError(f"prediction must have {least} faces or more. Received {shape}.")
    for name, array in (("prediction", prediction), ("truth", truth)):
        if not np.isfinite(array).all():
            raise InputError(f"{name} must be finite. Received NaN or infinity.")
    return prediction, truth


def _pearson(a: np.ndarray, b: np.ndarray, axis: int) -> np.ndarray:
    """Pearson correlation along an axis, 0 where either side is constant."""
    constant_a, constant_b = (
        np.ptp(x, axis=axis) <= _ROUNDING * np.abs(x).max(axis=axis) for x in (a, b)
    )
    constant = constant_a | constant_b
    a, b = (rescaled(x - x.mean(axis=axis, keepdims=True), axis)[0] for x in (a, b))
    covariance = (a * b).sum(axis=axis)
    scale = np.sqrt((a**2).sum(axis=axis) * (b**2).sum(axis=axis))
    return np.where(constant, 0.0, covariance / np.where(constant, 1.0, scale))
