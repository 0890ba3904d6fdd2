"""The limit: the error that is left to a method which knows the camera and the face model.

Coefficients of the face model are standard normal, and the view is nearly linear in them. With the
camera known but for the place and size of the face in the image, their posterior is Gaussian:
its precision is `A A^T / sd^2 + I`, where A is the Jacobian of the view at the true shape with a
flat prior on translation and scale. What draws from it differ by cannot be told from the view.
"""

from __future__ import annotations

import numpy as np

from data_gen.models.morphable_model import MorphableModel
from data_gen.views.projections import project
from deepmds_keras.alignment import align
from deepmds_keras.metrics import mse
from deepmds_keras.normalisation import normalise
from experiments.lifting.views import HardFaces

DRAWS = 8
_CHUNK = 20  # faces, each with a view for every coefficient
_STEP = 1e-3  # of a coefficient, by which the view is differentiated
# Of landmarks that are exact: a thousandth of a millimetre.
_LEAST_SD_MM = 1e-3


def limit(landmarks: MorphableModel, faces: HardFaces, rng: np.random.Generator) -> np.ndarray:
    """Mean squared error of draws from the posterior, after alignment to the ground truth: `(n,)`.

    Args:
        landmarks: Face model restricted to the landmarks.
        faces: With NaN where a landmark of a view is missing, of which it tells nothing.
        rng: Source of the draws.

    Returns:
        In squares of the unit of `normalise`.
    """
    chunks = (slice(start, start + _CHUNK) for start in range(0, len(faces), _CHUNK))
    return np.concatenate([_of_chunk(landmarks, faces[own], rng) for own in chunks])


def _of_chunk(landmarks, faces, rng):
    basis, n = landmarks.identity_basis_times_sd, len(faces)
    exact = project(faces.shapes, faces.cameras)
    sd = np.maximum(faces.sd_mm, _LEAST_SD_MM)
    certainty = np.isfinite(faces.views).all(-1) / sd[:, None]
    offsets = posterior_draws(view_jacobian(basis, faces, exact), exact, certainty, rng)
    shapes = faces.shapes[:, None] + np.tensordot(offsets, basis, 1)
    truth = np.repeat(normalise(faces.shapes), DRAWS, axis=0)
    drawn = shapes.reshape(len(truth), -1, 3)
    return mse(align(drawn, truth), truth).reshape(n, DRAWS).mean(1)


def view_jacobian(basis: np.ndarray, faces: HardFaces, exact: np.ndarray) -> np.ndarray:
    """Derivative of exact views `(n, L, 2)` by coefficients of a basis `(K, L, 3)`: `(n, K, L, 2)`.

    By differences, since the camera is set up by the landmarks that it sees.
    """
    n, k = len(faces), len(basis)
    moved = (faces.shapes[:, None] + _STEP * basis).reshape(n * k, -1, 3)
    views = project(moved, faces.cameras[np.repeat(np.arange(n), k)])
    return (views.reshape(n, k, -1, 2) - exact[:, None]) / _STEP


def posterior_draws(
    jacobian: np.ndarray, views: np.ndarray, certainty: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Draw coefficients from their posterior about its mean.

    Args:
        jacobian: `(n, K, L, 2)` derivatives of the views by standard-normal coefficients.
        views: `(n, L, 2)`, whose translation and scale are not known.
        certainty: `(n, L)` one over the standard deviation of the errors of a landmark; 0 for one
            that is missing.
        rng: Source of the draws.

    Returns:
        `(n, DRAWS, K)`.
    """
    n, k = jacobian.shape[:2]
    ones, zeros = np.ones_like(views[..., 0]), np.zeros_like(views[..., 0])
    similarity = np.stack(
        [views - views.mean(1, keepdims=True), np.stack([ones, zeros], -1),
         np.stack([zeros, ones], -1)], 1,
    )  # fmt: skip
    rows = np.concatenate([jacobian, similarity], 1) * certainty[:, None, :, None]
    rows = rows.reshape(n, k + similarity.shape[1], -1)
    precision = rows @ np.swapaxes(rows, 1, 2)
    precision[:, range(k), range(k)] += 1
    factor = np.linalg.cholesky(precision)
    normal = rng.standard_normal((n, precision.shape[1], DRAWS))
    draws = np.linalg.solve(np.swapaxes(factor, 1, 2), normal)
    return np.swapaxes(draws[:, :k], 1, 2)
