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
_READ, _FACES_PER_READ = 24, 20
_LEAST_SD = 1e-6
# Root mean square error of a face, in radii, beyond which the detector has found something else.
_GROSS = 0.3


def upright(vectors: np.ndarray, radius: np.ndarray, roll: np.ndarray) -> np.ndarray:
    """Vectors `(n, L, 2)` of an image in the frame of the upright face, y up.

    Args:
        vectors: y down.
        radius: `(n,)` that becomes the unit.
        roll: `(n,)` degrees.
    """
    return turned(vectors * (1, -1) / radius[:, None, None], -roll)


def turned(vectors: np.ndarray, roll: np.ndarray) -> np.ndarray:
    """Vectors `(n, L, 2)`, y up, of an upright face in the view of one that leans by the roll."""
    angle = np.deg2rad(roll)[:, None]
    x, y = vectors[..., 0], vectors[..., 1]
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)


def is_gross(errors: np.ndarray) -> np.ndarray:
    """Whether what was found is not the face: `(n, L, 2)` → `(n,)`."""
    return np.sqrt((errors**2).sum(2).mean(1)) > _GROSS


def summarise_errors(errors: np.ndarray, views: np.ndarray, yaw: np.ndarray) -> DetectorErrors:
    """Mean and covariance of errors by yaw, and how they depend on the view, in few components.

    A face and its mirror image are as likely in photos, but the detector need not treat them
    alike: nothing is mirrored.

    Args:
        errors, views: `(n, L, 2)` as from `errors_on`.
        yaw: `(n,)` degrees.
    """
    nearest = nearest_bin(yaw, BINS)
    parts = [_summarise(errors[nearest == b], views[nearest == b]) for b in range(len(BINS))]
    return DetectorErrors(BINS, *(np.stack(own) for own in zip(*parts, strict=True)))


def _summarise(errors: np.ndarray, views: np.ndarray) -> tuple[np.ndarray, ...]:
    """All of `DetectorErrors` but the yaw, of one bin of it."""
    if len(errors) == 0:
        errors = views = np.zeros((1, *errors.shape[1:]))
    bias, view = errors.mean(0), views.mean(0)
    # A regression on the principal components of the views.
    n_read = min(_READ, len(errors) // _FACES_PER_READ)
    axes, sd = _components(views - view)
    read = (axes / np.maximum(sd, _LEAST_SD)[:, None, None])[:n_read]
    told = np.einsum("nld,rld->nr", views - view, read)
    write = np.einsum("nr,nld->rld", told, errors - bias) / len(errors)
    left = errors - bias - np.einsum("nr,rld->nld", told, write)
    return bias, view, _filled(read, _READ), _filled(write, _READ), *_spread(left)


def _spread(errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Components of errors of mean 0, times s.d., and the s.d. of what they leave."""
    axes, sd = _components(errors)
    components = _filled((sd[:, None, None] * axes)[:_COMPONENTS], _COMPONENTS)
    rest = (errors**2).mean(0) - (components**2).sum(0)
    return components, np.sqrt(np.maximum(rest, 0))


def _components(offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Principal axes `(r, L, 2)` of offsets `(n, L, 2)` and the s.d. along each."""
    flat = offsets.reshape(len(offsets), -1) / np.sqrt(len(offsets))
    _, sd, axes = np.linalg.svd(flat, full_matrices=False)
    return axes.reshape(-1, *offsets.shape[1:]), sd


def _filled(rows: np.ndarray, n: int) -> np.ndarray:
    """Rows and, after them, zeros: `n` in all."""
    return np.concatenate([rows, np.zeros((n - len(rows), *rows.shape[1:]))])


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
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors of a detector on photos, as `read_portraits` returns them.

    Returns:
        `(n, L, 2)` errors and true views in the frame of `DetectorErrors`, the errors NaN where no
        face was found; and `(n,)` whether the face was found, and nothing else in its place.
    """
    pixels = photos["pixels_ibug68"]
    inner = pixels[:, -N_INNER:]
    frame = rms_radius(inner), photos["roll"]
    own = convert(pixels, "ibug68", scheme)
    errors = upright(photos[detector] - own, *frame)
    found = np.isfinite(errors).all((1, 2))
    views = upright(own - inner.mean(1, keepdims=True), *frame)
    return errors, views, found & ~is_gross(np.nan_to_num(errors))


def detection_table(photos: dict[str, np.ndarray], detector: str, scheme: str) -> pd.DataFrame:
    """How many faces a detector finds, by how far they are turned, and how well.

    Returns:
        Rows of `detector, yaw, n_photos, found, rms`: the share of the photos, and over these the
        root mean square error of a coordinate of `ibug51`, in percent of the face's radius.
    """
    errors, _, found = errors_on(photos, detector, scheme)
    errors, nearest = errors[:, -N_INNER:], nearest_bin(photos["yaw"], BINS)
    rows = []
    for b, middle in enumerate(BINS):
        own = found[nearest == b]
        rms = 100 * np.sqrt((errors[nearest == b][own] ** 2).mean()) if own.any() else np.nan
        rows.append((detector, middle, len(own), own.mean() if len(own) else np.nan, rms))
    return pd.DataFrame(rows, columns=["detector", "yaw", "n_photos", "found", "rms"])
