"""Methods of the protocol `hard` that learn in closed form or are given the face model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from data_gen.fitting.landmark_fitting import LandmarkFitter
from deepmds_keras.baselines.aldrian import Aldrian
from deepmds_keras.baselines.linear import Linear
from deepmds_keras.baselines.mean_shape import MeanShape
from deepmds_keras.camera import affine_cameras, orthographic_cameras
from deepmds_keras.normalisation import normalise
from experiments.lifting.views import (
    Condition,
    HardFaces,
    landmark_model,
    training_faces,
)
from experiments.run import Run

_CHUNK = 500  # faces whose views are filled together
_SEEN_SD_MM = 0.1  # by which the regression of missing coordinates trusts the others
_MISFIT_FACES = 1000
_LEAST_VIEW_NOISE = 3.5e-3  # Aldrian's default


def predict_mean(run: Run, condition: Condition, faces: HardFaces) -> np.ndarray:
    """Mean of the training shapes."""
    train = training_faces(run, condition)
    shape = MeanShape().fit(normalise(train.shapes[..., :2]), normalise(train.shapes)).mean_
    return np.broadcast_to(shape, faces.shapes.shape)


def predict_linear(run: Run, condition: Condition, faces: HardFaces) -> np.ndarray:
    """Ridge regression; in training and test alike, missing coordinates are filled in first."""
    train = training_faces(run, condition)
    fill = filler(run, condition)
    ridge = Linear().fit(normalise(fill(train.views)), normalise(train.shapes))
    return ridge.predict(normalise(fill(faces.views)))


def predict_aldrian(run: Run, condition: Condition, faces: HardFaces) -> np.ndarray:
    """Fit by Aldrian and Smith, told the noise; missing coordinates are filled in first."""
    landmarks = landmark_model(run)
    views = filler(run, condition)(faces.views)
    noise = misfit(run, condition, "affine") / np.ptp(views, axis=1).max(1).mean()
    model = landmarks.mean, landmarks.identity_basis_times_sd
    return Aldrian(*model, view_noise=max(_LEAST_VIEW_NOISE, noise)).predict(views)


def predict_fit(run: Run, condition: Condition, faces: HardFaces) -> np.ndarray:
    """The project's fit of the face model to landmarks, told the noise, of those that are seen."""
    landmarks, sd = landmark_model(run), misfit(run, condition, "orthographic")
    found = []
    for view in faces.views:
        seen = np.flatnonzero(np.isfinite(view).all(-1))
        part = replace(landmarks, landmarks={"seen": seen})
        options = {"n_identity": landmarks.n_identity, "n_expression": 0, "landmark_sd": sd}
        found.append(LandmarkFitter(part, "seen", **options).fit(view[seen]).identity)
    return landmarks.shape(np.array(found))


def filler(run: Run, condition: Condition) -> Callable[[np.ndarray], np.ndarray]:
    """Return what puts missing coordinates where a regression on the others expects them.

    That is their mean given the others, if views are Gaussian as those of training are.
    """
    train = training_faces(run, replace(condition, missing=0))
    flat = train.views.reshape(len(train), -1)
    mean, covariance = flat.mean(0), np.cov(flat, rowvar=False)

    def fill(views: np.ndarray) -> np.ndarray:
        if np.isfinite(views).all():
            return views
        starts = range(0, len(views), _CHUNK)
        return np.concatenate([_filled(views[s : s + _CHUNK], mean, covariance) for s in starts])

    return fill


def _filled(views, mean, covariance):
    flat = views.reshape(len(views), -1)
    seen = np.isfinite(flat)
    offsets = np.where(seen, flat - mean, 0)
    # Rows and columns of what is missing are those of the unit matrix: it takes part in nothing.
    among = np.where(seen[:, :, None] & seen[:, None], covariance, 0)
    among[:, range(len(mean)), range(len(mean))] += np.where(seen, _SEEN_SD_MM**2, 1)
    expected = mean + np.linalg.solve(among, offsets[..., None])[..., 0] @ covariance
    return np.where(seen, flat, expected).reshape(views.shape)


def misfit(run: Run, condition: Condition, camera: str) -> float:
    """R.m.s. distance of a coordinate from where a kind of camera sees the true landmarks, mm.

    A method with that camera takes it all for noise: the errors of the landmarks, and perspective.

    Args:
        run, condition: Whose training views.
        camera: `"affine"` or `"orthographic"`.
    """
    faces = training_faces(run, replace(condition, missing=0))[:_MISFIT_FACES]
    if camera == "affine":
        fitted = affine_cameras(faces.views, faces.shapes)
        linear, shift = fitted[..., :3], fitted[..., 3]
    else:
        rotations, scales, shift = orthographic_cameras(faces.views, faces.shapes)
        linear = scales[:, None, None] * rotations[:, :2]
    seen = faces.shapes @ np.swapaxes(linear, 1, 2) + shift[:, None]
    return float(np.sqrt(np.mean((faces.views - seen) ** 2)))


PREDICT = {
    "mean_shape": predict_mean,
    "linear": predict_linear,
    "aldrian": predict_aldrian,
    "model_fit": predict_fit,
}
