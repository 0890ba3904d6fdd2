"""The surface of a head through given 3D landmarks: its conditional mean under a face model."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deepmds_keras.errors import check_choice
from deepmds_keras.files import read_npz
from deepmds_keras.geometry.alignment import procrustes

FILE = Path(__file__).with_name("surface.npz")  # CC0, see data_gen/assets/LICENSE-openhead.md
# Landmarks have independent errors, and faces differ from the model by a smooth field: standard
# deviations of a coordinate and the range of the field, mm. Chosen on exact landmarks of faces of
# both open models, whose errors hardly change near these values.
_LANDMARK_SD, _MODEL_SD, _MODEL_RANGE = 1.0, 3.0, 20.0
_ROUNDS = 3  # of alignment and conditional mean; further ones change less than 0.01 mm


class _Head(NamedTuple):
    mean: np.ndarray  # (V, 3)
    basis: np.ndarray  # (r, V, 3), of standard normal coefficients
    triangles: np.ndarray
    landmarks: dict[str, np.ndarray]


def surface_triangles() -> np.ndarray:
    """Triangles of the surface, `(T, 3)` int, 0-based, counter-clockwise seen from outside."""
    return _head().triangles


def surface_landmarks(scheme: str) -> np.ndarray:
    """Vertices that are the landmarks of a scheme, `(L,)` int."""
    return _head().landmarks[scheme]


def fit_surfaces(shapes: np.ndarray, scheme: str) -> np.ndarray:
    """Most probable heads, given their landmarks.

    Shape and landmarks are jointly Gaussian: principal components of the open head with its
    expressions, and a smooth field for what they do not span (Lüthi et al. 2018, "Gaussian process
    morphable models", doi:10.1109/TPAMI.2017.2739743). Landmarks are first aligned by a similarity,
    which is not part of that model. Parts far from all landmarks, such as ears and crown, are a
    guess.

    Args:
        shapes: `(n, L, 3)` landmarks in any unit, +x to the subject's left, +y up, +z out of the
            face.
        scheme: Scheme of the landmarks, `"ibug51"`, `"ibug68"` or `"bfm72"`.

    Returns:
        `(n, V, 3)` float32 vertices in the frame and unit of the shapes.

    Raises:
        InputError: Another scheme.
    """
    head = _head()
    check_choice(scheme, "the scheme of a head", head.landmarks)
    gain = _gain(scheme)
    mean, columns = head.mean[head.landmarks[scheme]], _columns(scheme)
    seen = np.tile(mean, (len(shapes), 1, 1))
    for _ in range(_ROUNDS):
        rotation, scale, shift = procrustes(shapes, seen, reflection=False)
        scale, shift = scale[:, None, None], shift[:, None]
        off = (scale * (shapes @ rotation) + shift - mean).reshape(len(shapes), -1)
        seen = mean + (off @ gain[:, columns]).reshape(shapes.shape)
    vertices = head.mean + (off @ gain).reshape(len(shapes), -1, 3)
    placed = (vertices - shift) / scale @ np.swapaxes(rotation, 1, 2)
    return placed.astype(np.float32)


@cache
def _head() -> _Head:
    arrays = read_npz(FILE, "the head model of the package")
    return _Head(
        arrays["mean"].astype(float),
        arrays["basis"] * arrays["scale"].astype(float)[:, None, None],
        arrays["triangles"].astype(int),
        {
            key.removeprefix("landmarks_"): vertices.astype(int)
            for key, vertices in arrays.items()
            if key.startswith("landmarks_")
        },
    )


@cache
def _gain(scheme: str) -> np.ndarray:
    """Linear map from offsets of the landmarks to those of the vertices: `(3 L, 3 V)`."""
    head = _head()
    landmarks = head.landmarks[scheme]
    basis = head.basis.reshape(len(head.basis), -1)
    of_landmarks = head.basis[:, landmarks].reshape(len(basis), -1)
    apart = head.mean[landmarks, None] - head.mean
    field = _MODEL_SD**2 * np.exp(-(apart**2).sum(2) / (2 * _MODEL_RANGE**2))
    covariance = of_landmarks.T @ basis + np.kron(field, np.eye(3))
    columns = _columns(scheme)
    noise = _LANDMARK_SD**2 * np.eye(len(columns))
    return np.linalg.solve(covariance[:, columns] + noise, covariance)


def _columns(scheme: str) -> np.ndarray:
    """Indices of the landmarks' coordinates among those of all vertices."""
    return (3 * _head().landmarks[scheme][:, None] + np.arange(3)).ravel()
