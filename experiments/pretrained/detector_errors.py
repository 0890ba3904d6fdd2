"""Errors of the detectors on photos whose truth is known: bias and covariance by yaw."""

from __future__ import annotations

import numpy as np
import pandas as pd

from deepmds_keras.detection.errors import DetectorErrors, nearest_bin
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.landmarks.conversion import convert
from deepmds_keras.normalisation import rms_radius

BINS = np.arange(-60.0, 61.0, 20.0)  # middles, degrees of yaw
N_INNER = 51  # landmarks of `ibug51`, the last of `ibug68`: all but the jaw
_COMPONENTS = 16
# Root mean square error of a face, in radii, beyond which the detector has found something else.
_GROSS = 0.3


def upright_errors(
    found: np.ndarray, pixels: np.ndarray, radius: np.ndarray, roll: np.ndarray
) -> np.ndarray:
    """Errors in the frame of the upright face, in radii of the view, y up.

    Args:
        found, pixels: `(n, L, 2)` found and true landmarks, y down.
        radius: `(n,)` of the true landmarks.
        roll: `(n,)` degrees.
    """
    error = (found - pixels) * (1, -1) / radius[:, None, None]
    return turned(error, -roll)


def turned(vectors: np.ndarray, roll: np.ndarray) -> np.ndarray:
    """Vectors `(n, L, 2)`, y up, of an upright face in the view of one that leans by the roll."""
    angle = np.deg2rad(roll)[:, None]
    x, y = vectors[..., 0], vectors[..., 1]
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)


def is_gross(errors: np.ndarray) -> np.ndarray:
    """Whether what was found is not the face: `(n, L, 2)` → `(n,)`."""
    return np.sqrt((errors**2).sum(2).mean(1)) > _GROSS


def summarise_errors(errors: np.ndarray, yaw: np.ndarray) -> DetectorErrors:
    """Mean and covariance of errors `(n, L, 2)` by yaw `(n,)`, that in few components.

    A face and its mirror image are as likely in photos, but the detector need not treat them
    alike: nothing is mirrored.
    """
    nearest = nearest_bin(yaw, BINS)
    parts = [_summarise(errors[nearest == b]) for b in range(len(BINS))]
    return DetectorErrors(BINS, *(np.stack(own) for own in zip(*parts, strict=True)))


def _summarise(errors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    n, n_landmarks = errors.shape[:2]
    components = np.zeros((_COMPONENTS, n_landmarks, 2))
    if n == 0:
        return np.zeros((n_landmarks, 2)), components, np.zeros((n_landmarks, 2))
    bias = errors.mean(0)
    offsets = (errors - bias).reshape(n, -1)
    _, singular, axes = np.linalg.svd(offsets / np.sqrt(max(n - 1, 1)), full_matrices=False)
    found = (singular[:, None] * axes)[:_COMPONENTS].reshape(-1, n_landmarks, 2)
    components[: len(found)] = found
    rest = errors.var(0) - (components**2).sum(0)
    return bias, components, np.sqrt(np.maximum(rest, 0))


def errors_table(detector: str, scheme: str, errors: np.ndarray, yaw: np.ndarray) -> pd.DataFrame:
    """Bias and s.d. by landmark and yaw, in percent of the face's radius: for the reader.

    Returns:
        Rows of `detector, yaw, n_faces, landmark, bias_x, bias_y, sd_x, sd_y`.
    """
    nearest = nearest_bin(yaw, BINS)
    rows = []
    for b, middle in enumerate(BINS):
        own = errors[nearest == b]
        if len(own) < 2:
            continue
        numbers = np.hstack([own.mean(0), own.std(0, ddof=1)]) * 100
        rows += [
            (detector, middle, len(own), name, *row)
            for name, row in zip(load_scheme(scheme).names, numbers, strict=True)
        ]
    columns = ("detector", "yaw", "n_faces", "landmark", "bias_x", "bias_y", "sd_x", "sd_y")
    return pd.DataFrame(rows, columns=columns)


def errors_on(
    photos: dict[str, np.ndarray], detector: str, scheme: str
) -> tuple[np.ndarray, np.ndarray]:
    """Errors of a detector on photos, as `read_portraits` returns them.

    Returns:
        `(n, L, 2)` as from `upright_errors`, NaN where no face was found; and `(n,)` whether the
        face was found, and nothing else in its place.
    """
    pixels = photos["pixels_ibug68"]
    radius = rms_radius(pixels[:, -N_INNER:])
    own = convert(pixels, "ibug68", scheme)
    errors = upright_errors(photos[detector], own, radius, photos["roll"])
    found = np.isfinite(errors).all((1, 2))
    return errors, found & ~is_gross(np.nan_to_num(errors))
