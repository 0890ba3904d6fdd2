"""Fits a morphable model and a scaled orthographic camera to the 2D landmarks of one face."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.errors import InputError
from deepmds_keras.geometry.camera import HeadPose, orthographic_cameras

N_POSE = 6  # rotation vector, logarithm of the scale, translation
_DAMPING = 1e-3  # of the first step, as a share of the diagonal
_LEAST_DAMPING = 1e-7  # far below any effect, yet a few failed steps bring it back
_TOLERANCE = 1e-6  # change of the cost, as a share of 1 + cost, that ends a fit
_MAX_ITERATIONS = 100  # faces take 4 to 25, the more the worse the model explains them
_THINNEST = 0.05  # narrow over long side of the landmarks; of faces, even from the side, above 0.2


@dataclass(frozen=True, eq=False)
class LandmarkFit:
    """A face model and a camera whose view of the model's landmarks is nearest to those given.

    The vertices are `model.shape(fit.identity, fit.expression)`, in the frame of the model and in
    millimetres of its scale: one view alone does not tell a near small face from a far large one.

    Attributes:
        identity: `(K,)` standard-normal coefficients.
        expression: `(E,)` weights, or None where the fit was of neutral faces.
        camera: Camera from the frame of the model to pixels, y up.
        n_iterations: Steps tried.
        converged: Whether the last step changed next to nothing.
    """

    identity: np.ndarray
    expression: np.ndarray | None
    camera: HeadPose
    n_iterations: int
    converged: bool


class LandmarkFitter:
    """Maximum a posteriori fit by Levenberg and Marquardt's method; one face a call.

    The camera is scaled orthographic (weak perspective), as in the landmark fitter that comes with
    FLAME (github.com/TimoBolkart/TF_FLAME) and in Bas et al. 2016, arXiv:1602.01125. The cost is
    the squared distance in the image, in units of the landmarks' noise, plus the squares of the
    identity coefficients and expression weights, in units of their standard deviations. That is the
    prior of Blanz and Vetter 1999, doi:10.1145/311535.311556. Pose, identity and expression are
    optimised together, with the analytic Jacobian. A fit takes about 2 ms where BLAS runs in one
    thread (`threadpoolctl`); on a busy machine its threads wait for each other many times as long.

    Args:
        n_identity: How many of the first identity components to fit, if the model has as many.
        n_expression: How many of the first expression components to fit, if the model has as
            many; None is all, 0 fits neutral faces.
        landmark_sd: Standard deviation of each coordinate of the given points, in millimetres on
            the face, so that it means the same at every size and pose. The default, 1.7 % of the
            90 mm between the outer corners of the eyes, is about what remains between fitted faces
            and the landmarks of photos.

    Raises:
        InputError: The model has no landmarks of that scheme.
    """

    def __init__(
        self,
        model: MorphableModel,
        scheme: str = "ibug51",
        *,
        n_identity: int = 100,
        n_expression: int | None = None,
        landmark_sd: float = 1.5,
    ):
        part = model.at_landmarks(scheme)
        mean, bases = part.mean, [part.identity_basis_times_sd[:n_identity]]
        self._has_expression = part.expression_basis is not None and n_expression != 0
        self._expression_sd = model.expression_sd
        if self._has_expression:
            bases.append(part.expression_basis[:n_expression] * self._expression_sd)
            if part.expression_mean is not None:
                mean = mean + part.expression_mean
        # Every coefficient is standard normal in here, whatever it is of.
        self._basis = np.concatenate(bases).astype(float)
        self._n_identity = len(bases[0])
        # Turning about the middle of the face leaves its place in the image as it is.
        self._centre = mean.mean(0)
        self._mean = mean - self._centre
        self._landmark_sd = landmark_sd

    def fit(self, points: np.ndarray) -> LandmarkFit:
        """The most probable face and camera.

        Args:
            points: `(L, 2)` pixels, x to the right and y up.

        Raises:
            InputError: The points cannot be a face: in one place or on one line, or seen from
                behind (as when y points down).
        """
        long, narrow = np.linalg.svd(points - points.mean(0), compute_uv=False)
        if not narrow > _THINNEST * long:
            raise InputError(
                "points must not lie on one line. "
                f"Received an extent of {narrow:.3g} by {long:.3g}."
            )
        pose = orthographic_cameras(points[None], self._mean[None])[0]
        if pose.rotation[2, 2] <= 0:
            raise InputError(
                "points must be a face seen from the front, x to the right and y up. "
                "Received one seen from behind or mirrored."
            )
        noise = self._landmark_sd * pose.scale
        coefficients, shape = np.zeros(len(self._basis)), self._mean
        residuals = (seen_by(pose, shape) - points) / noise
        cost = (residuals**2).sum()
        damping, converged, n_iterations = _DAMPING, False, 0
        curvature = None
        # SciPy's least_squares ends within 3e-4 of the same coefficients after 7 times as long (by
        # "dogbox" or "lm", by "trf" 300 times): it decomposes the Jacobian with the prior's rows.
        while not converged and n_iterations < _MAX_ITERATIONS:
            n_iterations += 1
            if curvature is None:
                curvature, gradient = normal_equations(
                    jacobian(pose, shape, self._basis) / noise, residuals, coefficients
                )
            damped = curvature + damping * np.diag(np.diag(curvature))
            step = np.linalg.solve(damped, -gradient)
            new_pose, new_coefficients = moved(pose, step), coefficients + step[N_POSE:]
            new_shape = self._mean + np.tensordot(new_coefficients, self._basis, 1)
            new_residuals = (seen_by(new_pose, new_shape) - points) / noise
            new_cost = (new_residuals**2).sum() + (new_coefficients**2).sum()
            converged = bool(abs(cost - new_cost) <= _TOLERANCE * (1 + cost))
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
            camera=replace(pose, translation=seen_by(pose, -self._centre)),
            n_iterations=n_iterations,
            converged=converged,
        )


def seen_by(camera: HeadPose, points: np.ndarray) -> np.ndarray:
    """`camera.project` of a scaled orthographic camera, to the last digit as fits have it."""
    return camera.scale * points @ camera.rotation[:2].T + camera.translation


def jacobian(camera: HeadPose, points: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Derivatives of what an orthographic camera sees, `(6 + K, n, 2)`.

    They are by the `N_POSE` numbers of `moved`, then by the coefficients, with each of which the
    points `(n, 3)`, millimetres, move by `basis` `(K, n, 3)`.
    """
    by_pose = np.zeros((N_POSE, len(points), 2))
    x, y, z = camera.scale * camera.rotation @ points.T
    by_pose[1, :, 0], by_pose[2, :, 0] = z, -y
    by_pose[0, :, 1], by_pose[2, :, 1] = -z, x
    by_pose[3, :, 0], by_pose[3, :, 1] = x, y
    by_pose[4, :, 0] = by_pose[5, :, 1] = 1
    return np.concatenate([by_pose, camera.scale * basis @ camera.rotation[:2].T])


def moved(camera: HeadPose, step: np.ndarray) -> HeadPose:
    """The camera after a step: rotation vector, logarithm of the scale, translation."""
    turn = Rotation.from_rotvec(step[:3]).as_matrix()
    scale = camera.scale * np.exp(step[3])
    return HeadPose(turn @ camera.rotation, scale, camera.translation + step[4:6])


def normal_equations(
    derivatives: np.ndarray, residuals: np.ndarray, coefficients: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Curvature and gradient of half the cost, whose prior is of standard-normal coefficients.

    Derivatives are `(6 + K, ...)` as from `jacobian`, residuals `(...)` in units of their s.d.
    """
    rows = derivatives.reshape(len(derivatives), -1)
    curvature = rows @ rows.T
    curvature.flat[N_POSE * (len(curvature) + 1) :: len(curvature) + 1] += 1
    gradient = rows @ residuals.ravel()
    gradient[N_POSE:] += coefficients
    return curvature, gradient
