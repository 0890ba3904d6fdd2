"""Fit of a morphable model to views in perspective: the most probable shape and camera."""

from dataclasses import KW_ONLY, dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from sklearn.base import BaseEstimator

from deepmds_keras.errors import InputError
from deepmds_keras.geometry.camera import orthographic_cameras
from deepmds_keras.geometry.units import rms_radius
from deepmds_keras.lifting.inputs import prepare_views
from deepmds_keras.validation import as_numbers, check_face_model, of_one_or_many

CHUNK = 128  # faces solved together: bounds the memory of their equations to about 100 MB
# Standard deviations that are assumed at first, in parts of the radius of the view: identity is
# to explain what the camera does not, not the other way round.
_STAGES = (0.1, 0.01, 0.0)
_STEPS = 6  # of each stage
_LEAST_SD = 3e-4  # of exact landmarks, in parts of the radius
_N_CAMERA = 7  # rotation, logarithm of the scale, perspective, translation
# A step at most halves or doubles the scale: what the mean shape does not explain would shrink it
# to nothing at once, where the equations have no solution.
_MOST_CHANGE = np.log(2)


@dataclass(eq=False, repr=False)
class MapFit(BaseEstimator):
    """Maximum a posteriori fit of a morphable model that is known, as is the noise.

    Code, rotation, scale, perspective and translation are found together by Gauss-Newton steps on
    the logarithm of the posterior (Blanz and Vetter 2003, doi:10.1109/TPAMI.2003.1227983, by the
    landmarks alone). The code is standard normal, the perspective normal; other priors are flat.

    A step marginalises over the code: seen by a linearised camera, a view is Gaussian with the
    covariance J J^T + noise of its 2L coordinates, which is inverted instead of the matrix of the
    K components.

    Args:
        mean: `(L, 3)` landmarks of the mean face, in any unit.
        basis_times_sd: `(K, L, 3)` offsets at one standard deviation, in the same unit.
        perspective: Mean and standard deviation of the camera's inverse distance, times the r.m.s.
            radius of the mean face.
    """

    mean: np.ndarray
    basis_times_sd: np.ndarray
    _: KW_ONLY
    perspective: tuple[float, float] = (0.0, 0.1)
    n_parameters = 0  # none are trained: the face model is given

    def predict(self, views: np.ndarray, landmark_sd: float | np.ndarray = 0.0) -> np.ndarray:
        """Most probable shapes, `(n, L, 3)` or `(L, 3)`, in the unit and frame of `mean`.

        Args:
            views: `(n, L, 2)` or `(L, 2)`, any scale and place, y up; NaN where one is missing.
            landmark_sd: Standard deviation of the noise of a coordinate in the unit of the views:
                one number, `(n,)`, or `(n, L)`; None is none.

        Raises:
            InputError: An unusable model, prior or noise, or a view with fewer than six landmarks.
        """
        mean, basis = check_face_model(self.mean, self.basis_times_sd)
        prior = as_numbers(self.perspective, "perspective")
        if prior.shape != (2,) or not np.isfinite(prior).all() or prior[1] <= 0:
            raise InputError(
                "perspective must be a finite mean and a positive s.d. "
                f"Received {self.perspective}."
            )
        seen = prepare_views(views, len(mean), landmark_sd=landmark_sd)
        centre, radius = mean.mean(0), rms_radius(mean[None])[0]
        model = _Model((mean - centre) / radius, basis / radius, *prior)
        sd = np.zeros_like(seen.visible) if seen.sd is None else seen.sd
        arrays = seen.views.swapaxes(1, 2).astype(float), seen.visible[..., None], sd
        chunks = [slice(start, start + CHUNK) for start in range(0, len(sd), CHUNK)]
        shapes = np.concatenate([_fit(model, *(a[chunk] for a in arrays)) for chunk in chunks])
        return of_one_or_many(shapes * radius + centre, views)


def principal_components(shapes: np.ndarray, least_sd: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean `(L, 3)` of shapes `(n, L, 3)` and principal components times s.d., `(K, L, 3)`.

    What is not Gaussian is replaced by the Gaussian with its moments. Components whose s.d. is at
    most `least_sd`, over all coordinates together, are left out.
    """
    n, mean = len(shapes), shapes.mean(0)
    flat = (shapes - mean).reshape(n, -1)
    values, vectors = np.linalg.eigh(flat.T @ flat / n)
    kept = values > least_sd**2
    basis = (vectors[:, kept] * np.sqrt(values[kept])).T[::-1]
    return mean, basis.reshape(-1, *mean.shape)


class _Model:
    """Face model about its centre, in its radius, with the covariance of its coordinates."""

    def __init__(self, mean, basis, perspective, perspective_sd):
        self.mean, self.basis = mean, basis.reshape(len(basis), -1)
        self.perspective, self.perspective_sd = perspective, perspective_sd
        self.covariance = (self.basis.T @ self.basis).reshape(*mean.shape, *mean.shape)

    def shapes(self, code: np.ndarray) -> np.ndarray:
        return self.mean + (code @ self.basis).reshape(-1, *self.mean.shape)


class _State(NamedTuple):
    """Codes of n faces and their cameras, about the centre of the mean face."""

    code: np.ndarray  # (n, K)
    rotation: np.ndarray  # (n, 3, 3)
    log_scale: np.ndarray  # (n,)
    perspective: np.ndarray  # (n,)
    translation: np.ndarray  # (n, 2)


class _Views(NamedTuple):
    """Views of n faces about their middle, in their radius; zeros where a landmark is missing."""

    points: np.ndarray  # (n, L, 2)
    seen: np.ndarray  # (n, L, 1)
    variance: np.ndarray  # (n, L, 1)


def _fit(model: _Model, points: np.ndarray, seen: np.ndarray, sd: np.ndarray) -> np.ndarray:
    # Whatever is not seen lies in the middle of the rest, where it has no influence.
    middle = (model.mean * seen).sum(1, keepdims=True) / seen.sum(1, keepdims=True)
    camera = orthographic_cameras(points, np.where(seen, model.mean, middle))
    state = _State(
        np.zeros((len(points), len(model.basis))),
        camera.rotation,
        np.log(camera.scale),
        np.full(len(points), float(model.perspective)),
        camera.translation,
    )
    for floor in _STAGES:
        variance = np.maximum(np.hypot(sd, floor), _LEAST_SD)[..., None] ** 2
        state = _maximise(model, state, _Views(points, seen, variance))
    return model.shapes(state.code)


def _maximise(model: _Model, state: _State, views: _Views) -> _State:
    """Steps that are made shorter where they would go astray."""
    length, best = np.ones(len(views.points)), _objective(model, state, views)
    for _ in range(_STEPS):
        tried = _step(model, state, views, length)
        objective = _objective(model, tried, views)
        better = objective < best
        chosen = (
            np.where(better.reshape(-1, *[1] * (new.ndim - 1)), new, old)
            for new, old in zip(tried, state, strict=True)
        )
        state, best = _State(*chosen), np.where(better, objective, best)
        length = np.where(better, np.minimum(1, 2 * length), length / 4)
    return state


def _objective(model: _Model, state: _State, views: _Views) -> np.ndarray:
    """Twice the negative logarithm of the posterior, but for a constant: `(n,)`."""
    off, *_ = _look(model, state, views)
    of_camera = (state.perspective - model.perspective) / model.perspective_sd
    return (off**2 / views.variance).sum((1, 2)) + (state.code**2).sum(1) + of_camera**2


def _look(model: _Model, state: _State, views: _Views):
    """Residuals, points in the frame of the camera, their scales, and what the camera sees."""
    posed = model.shapes(state.code) @ np.swapaxes(state.rotation, 1, 2)
    near = 1 / (1 - state.perspective[:, None, None] * posed[..., 2:])
    near = near * np.exp(state.log_scale)[:, None, None]
    flat = near * posed[..., :2]
    off = views.seen * (views.points - flat - state.translation[:, None])
    return off, posed, near, flat


def _step(model: _Model, state: _State, views: _Views, length: np.ndarray) -> _State:
    off, posed, near, flat = _look(model, state, views)
    n, n_landmarks = off.shape[:2]
    scale = np.exp(state.log_scale)[:, None, None]
    # Derivatives of what is seen by the points in the camera's frame, (n, L, 2, 3).
    by_point = np.zeros((n, n_landmarks, 2, 3))
    by_point[..., [0, 1], [0, 1]] = near
    by_point[..., 2] = flat * near * state.perspective[:, None, None] / scale
    by_camera = np.empty((n, n_landmarks, 2, _N_CAMERA))
    x, y, z = np.moveaxis(posed, 2, 0)
    zero = np.zeros_like(x)
    # Of a small rotation w after the present one, which moves a point p by w x p.
    turned = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], 2).reshape(n, n_landmarks, 3, 3)
    by_camera[..., :3] = by_point @ turned
    by_camera[..., 3] = flat
    by_camera[..., 4] = flat * near * z[..., None] / scale
    by_camera[..., 5:] = np.eye(2)
    by_shape = (by_point @ state.rotation[:, None]) * views.seen[..., None]
    by_camera = (by_camera * views.seen[..., None]).reshape(n, -1, _N_CAMERA)
    # Covariance of the view whatever the code is, (n, 2L, 2L).
    half = by_shape @ model.covariance.reshape(n_landmarks, 3, -1)
    half = half.reshape(n, 2 * n_landmarks, n_landmarks, 3).swapaxes(1, 2)
    covariance = (half @ np.swapaxes(by_shape, 2, 3)).transpose(0, 2, 1, 3)
    covariance = covariance.reshape(n, 2 * n_landmarks, -1)
    diagonal = range(2 * n_landmarks)
    covariance[:, diagonal, diagonal] += np.repeat(views.variance[..., 0], 2, axis=1)
    # The view as it would be if the code were zero.
    of_code = (state.code @ model.basis).reshape(n, n_landmarks, 3, 1)
    target = (off + (by_shape @ of_code)[..., 0]).reshape(n, -1, 1)
    weighted = np.linalg.solve(covariance, np.concatenate([by_camera, target], 2))
    by_camera = np.swapaxes(by_camera, 1, 2)
    normal, right = by_camera @ weighted[..., :-1], (by_camera @ weighted[..., -1:])[..., 0]
    normal[:, 4, 4] += 1 / model.perspective_sd**2
    right[:, 4] += (model.perspective - state.perspective) / model.perspective_sd**2
    camera = np.linalg.solve(normal, right[..., None])
    unexplained = (weighted[..., -1:] - weighted[..., :-1] @ camera).reshape(n, n_landmarks, 2, 1)
    code = (np.swapaxes(by_shape, 2, 3) @ unexplained).reshape(n, -1) @ model.basis.T
    change = length[:, None] * camera[..., 0]
    change[:, 3] = change[:, 3].clip(-_MOST_CHANGE, _MOST_CHANGE)
    return _State(
        state.code + length[:, None] * (code - state.code),
        Rotation.from_rotvec(change[:, :3]).as_matrix() @ state.rotation,
        state.log_scale + change[:, 3],
        state.perspective + change[:, 4],
        state.translation + change[:, 5:],
    )
