"""Comparisons for the networks on hard views: simpler methods, and an approximate lower bound.

The bound is the error of a method that knows the camera and the face model. Coefficients of the
face model are standard normal, and the view is nearly linear in them. With the camera known except
for the position and size of the face in the image, their posterior is Gaussian: its precision is
`A A^T / sd^2 + I`, where A is the Jacobian of the view at the true shape with a flat prior on
translation and scale. Draws from it are indistinguishable by the view.
"""

from dataclasses import replace

import numpy as np

from deepmds_keras.baselines.closed_form import Aldrian, MeanShape, RidgeRegression
from deepmds_keras.baselines.mlp import MLP
from deepmds_keras.geometry.alignment import align
from deepmds_keras.geometry.camera import affine_cameras
from deepmds_keras.geometry.units import normalise, rms_radius
from deepmds_keras.geometry.views import project
from deepmds_keras.metrics import mse
from experiments.lifting.views import Condition, Views, landmark_model, training_views
from experiments.recipes import map_fit_of, mlp
from experiments.run import Run
from experiments.tasks import single_threaded

_CHUNK = 500  # faces whose views are filled together
_SEEN_SD_MM = 0.1  # noise of the visible coordinates in the regression of missing ones
_MISFIT_FACES = 1000
_HINDSIGHT_SD, _HINDSIGHT_FACES = (0.005, 0.01, 0.02, 0.03, 0.05, 0.08, 0.12), 500  # in radii
DRAWS = 8  # from the posterior of a face
_FACES = 20  # at a time, each with a view for every coefficient
_STEP = 1e-3  # of a coefficient, by which the view is differentiated
_LEAST_SD_MM = 1e-3  # of exact landmarks


def simple_methods(run: Run, condition: Condition, faces: Views) -> dict[str, np.ndarray]:
    """Shapes `(n, L, 3)` of faces by the simpler methods of the protocol `hard`, by their ids.

    The condition is that of the training views, and of the noise that the fits assume. In training
    and test, missing coordinates are filled in first, except for the MAP fit.
    """
    train = training_views(run, condition)
    whole = training_views(run, replace(condition, missing=0.0))
    model = landmark_model(run)
    mean, basis = model.mean, model.identity_basis_times_sd
    fitted = fit_regressions(
        normalise(fill(train.views, whole.views)), normalise(train.shapes), mlp(run)
    )
    views = fill(faces.views, whole.views)
    shapes = {method: fit.predict(normalise(views)) for method, fit in fitted.items()}
    shapes["aldrian"] = fit_aldrian(mean, basis, views, _misfit(whole[:_MISFIT_FACES]))
    fit = map_fit_of(mean, basis, train.cameras.field_of_view)
    with single_threaded():
        shapes["map"] = fit.predict(faces.views, faces.sd_mm)
    return shapes


def fit_regressions(views: np.ndarray, shapes: np.ndarray, net: MLP) -> dict:
    """Methods that learn from normalised views and shapes, by their ids; the MLP is untrained."""
    methods = {
        "mean_shape": MeanShape(),
        "ridge": RidgeRegression(),
        "ridge_roll_aligned": RidgeRegression(roll_aligned=True),
        "mlp": net,
    }
    with single_threaded():  # the last bits depend on the threads
        return {name: method.fit(views, shapes) for name, method in methods.items()}


def fill(views: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Fill in missing coordinates of `(n, L, 2)` by a regression on the others.

    It gives their conditional mean if views are Gaussian with the moments of `whole`, `(m, L, 2)`.
    """
    if np.isfinite(views).all():
        return views
    flat = whole.reshape(len(whole), -1)
    mean, covariance = flat.mean(0), np.cov(flat, rowvar=False)
    filled = []
    for start in range(0, len(views), _CHUNK):
        flat = views[start : start + _CHUNK].reshape(-1, len(mean))
        known, places = np.isfinite(flat), range(len(mean))
        offsets = np.where(known, flat - mean, 0)
        # Missing coordinates get rows and columns of the unit matrix: no influence.
        among = np.where(known[:, :, None] & known[:, None], covariance, 0)
        among[:, places, places] += np.where(known, _SEEN_SD_MM**2, 1)
        weights = np.linalg.solve(among, offsets[..., None])[..., 0]
        filled.append(np.where(known, flat, mean + weights @ covariance))
    return np.concatenate(filled).reshape(views.shape)


def _misfit(faces: Views) -> float:
    """R.m.s. residual in mm of a coordinate when affine cameras are fitted to the true shapes.

    A method with such a camera must treat all of it as noise: landmark noise and perspective.
    """
    cameras = affine_cameras(faces.views, faces.shapes)
    projected = faces.shapes @ np.swapaxes(cameras[..., :3], 1, 2) + cameras[:, None, :, 3]
    return float(np.sqrt(np.mean((faces.views - projected) ** 2)))


def aligned_mse(shapes: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """`(n,)` errors of shapes after alignment to the truth, in squared units of `normalise`."""
    truth = normalise(truth)
    return mse(align(shapes, truth), truth)


def fit_aldrian(
    mean: np.ndarray, basis: np.ndarray, views: np.ndarray, sd: float | np.ndarray
) -> np.ndarray:
    """Shapes by Aldrian and Smith's fit to views `(n, L, 2)` with noise of known s.d.

    The model is a mean `(L, 3)` and a basis times standard deviation, `(K, L, 3)`. The fit assumes
    one s.d. for all landmarks: the mean.
    """
    noise = np.mean(sd) / np.ptp(views, axis=1).max(1).mean()
    # Below its default, the first, wrong cameras would be fitted too closely.
    return Aldrian(mean, basis, view_noise=max(Aldrian.view_noise, noise)).predict(views)


def fit_aldrian_in_hindsight(
    mean: np.ndarray, basis: np.ndarray, views: np.ndarray, shapes: np.ndarray
) -> np.ndarray:
    """The same fit with the best of several s.d. on some of the true shapes.

    It accounts for what neither noise nor face model tells: the distance of faces from the model.
    """
    radius, some = rms_radius(views)[:, None], slice(_HINDSIGHT_FACES)
    known = np.isfinite(shapes[0, :, 0])  # the face model may lack landmarks

    def error(part: float) -> float:
        fitted = fit_aldrian(mean, basis, views[some], part * radius[some])[:, known]
        return aligned_mse(fitted, shapes[some, known]).mean()

    return fit_aldrian(mean, basis, views, min(_HINDSIGHT_SD, key=error) * radius)


def lower_bound(run: Run, faces: Views, rng: np.random.Generator) -> np.ndarray:
    """Mean squared error of draws from the posterior, aligned to the ground truth: `(n,)`.

    A missing landmark contributes nothing. The unit is that of `normalise`, squared.
    """
    basis = landmark_model(run).identity_basis_times_sd
    errors = []
    for start in range(0, len(faces), _FACES):
        part = faces[start : start + _FACES]
        exact = project(part.shapes, part.cameras)
        # By finite differences, since the camera depends on the landmarks that it sees.
        moved = part.shapes[:, None] + _STEP * basis
        cameras = part.cameras[np.repeat(np.arange(len(part)), len(basis))]
        views = project(moved.reshape(-1, *moved.shape[2:]), cameras)
        jacobian = (views.reshape(*moved.shape[:3], 2) - exact[:, None]) / _STEP
        sd = np.maximum(part.sd_mm, _LEAST_SD_MM)
        certainty = np.isfinite(part.views).all(-1) / sd[:, None]
        offsets = posterior_draws(jacobian, exact, certainty, rng)
        shapes = part.shapes[:, None] + np.tensordot(offsets, basis, 1)
        truth = np.repeat(part.shapes, DRAWS, axis=0)
        errors.append(aligned_mse(shapes.reshape(truth.shape), truth))
    return np.concatenate(errors).reshape(-1, DRAWS).mean(1)


def posterior_draws(
    jacobian: np.ndarray, views: np.ndarray, certainty: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Draw coefficients from their posterior about its mean, `(n, DRAWS, K)`.

    Args:
        jacobian: `(n, K, L, 2)` derivatives of the views by standard-normal coefficients.
        views: `(n, L, 2)`, whose translation and scale are not known.
        certainty: `(n, L)` inverse standard deviation of the noise of a landmark; 0 if missing.
    """
    n, k = jacobian.shape[:2]
    shifts = np.broadcast_to(np.eye(2)[:, None], (n, 2, *views.shape[1:]))
    scale = views - views.mean(1, keepdims=True)
    rows = np.concatenate([jacobian, scale[:, None], shifts], 1) * certainty[:, None, :, None]
    rows = rows.reshape(n, k + 3, -1)
    precision = rows @ np.swapaxes(rows, 1, 2)
    precision[:, range(k), range(k)] += 1
    factor = np.linalg.cholesky(precision)
    normal = rng.standard_normal((n, k + 3, DRAWS))
    draws = np.linalg.solve(np.swapaxes(factor, 1, 2), normal)
    return np.swapaxes(draws[:, :k], 1, 2)
