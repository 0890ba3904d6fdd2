"""Fits a morphable model and a camera to the 2D landmarks of one face."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from data_gen.fitting.orthographic_camera import N_POSE, OrthographicCamera
from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.camera import orthographic_cameras
from deepmds_keras.errors import InputError

_DAMPING = 1e-3  # of the first step, as a share of the diagonal
_LEAST_DAMPING = 1e-7  # far below any effect, yet a few failed steps bring it back
_BLENDSHAPE_SD = 0.3  # fits to photos then stay between about -0.5 and 0.7
_THINNEST = 0.05  # narrow over long side of the landmarks; of faces, even from the side, above 0.2


@dataclass(frozen=True, eq=False)
class LandmarkFit:
    """A face model and a camera such that the model's landmarks are seen where they were found.

    The vertices are `model.shape(fit.identity, fit.expression)`, in the frame of the model and in
    millimetres of its scale: one view alone does not tell a near small face from a far large one.

    Attributes:
        identity: `(K,)` standard-normal coefficients.
        expression: `(E,)` weights, or None where the fit was of neutral faces.
        camera: From the frame of the model to pixels, y up.
        rms: Root mean square distance of the projected from the given landmarks, pixels.
        n_iterations: Steps tried.
        converged: Whether the last step changed the cost by less than the tolerance.
    """

    identity: np.ndarray
    expression: np.ndarray | None
    camera: OrthographicCamera
    rms: float
    n_iterations: int
    converged: bool


class LandmarkFitter:
    """Maximum a posteriori fit by Levenberg and Marquardt's method; one face a call.

    The camera is scaled orthographic (weak perspective), as in the landmark fitter that comes with
    FLAME (github.com/TimoBolkart/TF_FLAME) and in Bas et al. 2016, arXiv:1602.01125. The cost is
    the squared distance in the image, in units of the landmarks' noise, plus the squares of the
    identity coefficients and expression weights, in units of their standard deviations. That is the
    prior of Blanz and Vetter 1999, doi:10.1145/311535.311556. Pose, identity and expression are
    found together, with the analytic Jacobian. A fit takes about 2 ms where BLAS runs in one thread
    (`threadpoolctl`); on a busy machine its threads wait for each other many times as long.
    """

    def __init__(
        self,
        model: MorphableModel,
        scheme: str = "ibug51",
        *,
        n_identity: int = 100,
        n_expression: int | None = None,
        expression_sd: float | None = None,
        landmark_sd: float = 1.5,
        max_iterations: int = 100,
        tolerance: float = 1e-6,
    ):
        """Prepares a model for any number of fits.

        Args:
            model: Morphable model with landmarks of the scheme.
            scheme: Landmark scheme of the points.
            n_identity: How many of the first identity components to fit, if the model has as many.
            n_expression: How many of the first expression components to fit, if the model has as
                many; None is all, 0 fits neutral faces.
            expression_sd: Standard deviation of the expression weights about zero. None is 0.3
                where expressions have names, which are blendshapes of weights from 0 to 1 (open
                head, ICT-FaceKit), and 1 where they have none, which are principal components
                scaled to unit variance (FLAME, Basel Face Model).
            landmark_sd: Standard deviation of each coordinate of the given points, in millimetres
                on the face, so that it means the same at every size and pose. The default, 1.7 %
                of the 90 mm between the outer corners of the eyes, is about what remains between
                fitted faces and the landmarks of photos.
            max_iterations: Steps after which to give up. Faces take 4 to 25, the more the worse the
                model explains them.
            tolerance: Change of the cost, as a share of 1 + cost, that ends the fit.

        Raises:
            InputError: The model has no landmarks of that scheme, or an option is out of range.
        """
        if scheme not in model.landmarks:
            raise InputError(
                f"scheme must be one of {', '.join(model.landmarks) or 'none'} for {model.name}. "
                f"Received {scheme!r}."
            )
        if n_identity < 1 or (n_expression or 0) < 0 or max_iterations < 1:
            raise InputError(
                "n_identity and max_iterations must be at least 1, n_expression not negative. "
                f"Received {n_identity}, {max_iterations}, {n_expression}."
            )
        if expression_sd is None:
            expression_sd = _BLENDSHAPE_SD if model.expression_names else 1.0
        if not (expression_sd > 0 and landmark_sd > 0 and tolerance > 0):
            raise InputError(
                "expression_sd, landmark_sd and tolerance must be positive. "
                f"Received {expression_sd}, {landmark_sd}, {tolerance}."
            )
        part = model.restrict(model.landmarks[scheme])
        mean, bases = part.mean, [part.identity_basis_times_sd[:n_identity]]
        self._has_expression = part.expression_basis is not None and n_expression != 0
        if self._has_expression:
            bases.append(part.expression_basis[:n_expression] * expression_sd)
            if part.expression_mean is not None:
                mean = mean + part.expression_mean
        # Every coefficient is standard normal in here, whatever it is of.
        self._basis = np.concatenate(bases).astype(float)
        self._n_identity = len(bases[0])
        # Turning about the middle of the face leaves its place in the image as it is.
        self._centre = mean.mean(0)
        self._mean = mean - self._centre
        self._expression_sd = expression_sd
        self._landmark_sd = landmark_sd
        self._max_iterations = max_iterations
        self._tolerance = tolerance

    def fit(self, points: np.ndarray) -> LandmarkFit:
        """The most probable face and camera.

        Args:
            points: `(L, 2)` pixels, x to the right and y up.

        Raises:
            InputError: Not as many finite points as the scheme has landmarks, or they cannot be a
                face: in one place or on one line, or seen from behind (as when y points down).
        """
        points = self._check(points)
        pose = _starting_pose(self._mean, points)
        noise = self._landmark_sd * pose.scale
        coefficients = np.zeros(len(self._basis))
        shape = self._mean
        residuals = (pose.project(shape) - points) / noise
        cost = (residuals**2).sum()
        damping, converged, n_iterations = _DAMPING, False, 0
        curvature = None
        # SciPy's least_squares ends within 3e-4 of the same coefficients after 7 times as long (by
        # "dogbox" or "lm", by "trf" 300 times): it decomposes the Jacobian with the prior's rows.
        while not converged and n_iterations < self._max_iterations:
            n_iterations += 1
            if curvature is None:
                jacobian = pose.jacobian(shape, self._basis).reshape(-1, 2 * len(shape)) / noise
                curvature = jacobian @ jacobian.T
                curvature.flat[N_POSE * (len(curvature) + 1) :: len(curvature) + 1] += 1
                gradient = jacobian @ residuals.ravel()
                gradient[N_POSE:] += coefficients
            damped = curvature + damping * np.diag(np.diag(curvature))
            step = np.linalg.solve(damped, -gradient)
            new_pose, new_coefficients = pose.moved(step), coefficients + step[N_POSE:]
            new_shape = self._mean + np.tensordot(new_coefficients, self._basis, 1)
            new_residuals = (new_pose.project(new_shape) - points) / noise
            new_cost = (new_residuals**2).sum() + (new_coefficients**2).sum()
            converged = bool(abs(cost - new_cost) <= self._tolerance * (1 + cost))
            if new_cost < cost:
                pose, coefficients, shape = new_pose, new_coefficients, new_shape
                residuals, cost, curvature = new_residuals, new_cost, None
                damping = max(damping / 10, _LEAST_DAMPING)
            else:
                damping *= 10
        expression = coefficients[self._n_identity :] * self._expression_sd
        return LandmarkFit(
            identity=coefficients[: self._n_identity],
            expression=expression if self._has_expression else None,
            camera=replace(pose, translation=pose.project(-self._centre)),
            rms=float(noise * np.sqrt((residuals**2).sum(1).mean())),
            n_iterations=n_iterations,
            converged=converged,
        )

    def _check(self, points: np.ndarray) -> np.ndarray:
        points = np.asarray(points, float)
        if points.shape != (len(self._mean), 2):
            raise InputError(f"points must be ({len(self._mean)}, 2). Received {points.shape}.")
        if not np.isfinite(points).all():
            raise InputError("points must be finite. Received NaN or infinity.")
        long, narrow = np.linalg.svd(points - points.mean(0), compute_uv=False)
        if not narrow > _THINNEST * long:
            raise InputError(
                "points must be the landmarks of a face, spread in two directions. "
                f"Received {narrow:.3g} by {long:.3g}."
            )
        return points


def _starting_pose(shape: np.ndarray, points: np.ndarray) -> OrthographicCamera:
    """The camera that sees the mean face about as the points are."""
    (rotation,), (scale,), (translation,) = orthographic_cameras(points[None], shape[None])
    if rotation[2, 2] <= 0:
        raise InputError(
            "points must be of a face seen from in front, x to the right and y up. "
            "Received one seen from behind or mirrored."
        )
    return OrthographicCamera(rotation, scale, translation)
