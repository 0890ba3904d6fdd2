"""Morphable-model fit to landmarks by alternating linear solves, after Aldrian and Smith 2013."""

from __future__ import annotations

import numpy as np
from sklearn.base import BaseEstimator

from deepmds_keras.camera import affine_cameras, orthographic_cameras
from deepmds_keras.checks import check_faces, check_points
from deepmds_keras.errors import InputError

CAMERAS = ("affine", "orthographic")
CHUNK = 256  # faces solved together: bounds the (faces, K, K) normal matrices to some 80 MB
FLAT = 1e-5  # depth of a shape, as a share of its length, that leaves its affine camera open


class Aldrian(BaseEstimator):
    """Shape coefficients of a morphable model and an affine camera, in turns.

    Aldrian and Smith 2013 (doi:10.1109/TPAMI.2012.206), geometric part. Given the camera the
    coefficients have a closed form, `solve_shape`; given the shape so has the camera,
    `affine_cameras`. The first camera sees the mean face. Coefficients are standard normal, so
    with the true noise `regularisation=1` makes each solve a maximum a posteriori estimate.

    An affine camera can pass for part of the identity (stretched or sheared faces), where only
    the prior decides. The rounds creep along that valley, the slower the less noise is assumed:
    `max_iter` stops them before they settle, and too small a `view_noise` then does harm, since
    the first, wrong cameras are fitted too closely.

    Args:
        mean: `(L, 3)` landmarks of the mean face, in any unit.
        basis_times_sd: `(K, L, 3)` offsets at one standard deviation, in the same unit.
        camera: `"affine"` (the method's) or `"orthographic"`, the rotation, scale and shift next
            to it, which eos takes.
        view_noise: Standard deviation of the view's coordinates, as a part of the larger side of
            its bounding box. The default is eos's, sqrt(3) pixels, on a face of 500 pixels.
        shape_noise: Standard deviation of what the model cannot express, in the unit of `mean`;
            seen through the camera it adds to the noise of the view.
        regularisation: Weight of the prior on the coefficients.
        max_iter: Most rounds of camera and shape; the default is the number of the paper's code.
        tol: A face is done once no coefficient moves by more than this in a round.
    """

    def __init__(
        self,
        mean,
        basis_times_sd,
        *,
        camera="affine",
        view_noise=3.5e-3,
        shape_noise=0.0,
        regularisation=1.0,
        max_iter=50,
        tol=1e-4,
    ):
        self.mean = mean
        self.basis_times_sd = basis_times_sd
        self.camera = camera
        self.view_noise = view_noise
        self.shape_noise = shape_noise
        self.regularisation = regularisation
        self.max_iter = max_iter
        self.tol = tol

    @property
    def n_parameters(self) -> int:
        """Trainable parameters: none, the face model is given."""
        return 0

    def predict(self, views: np.ndarray) -> np.ndarray:
        """Shapes of the faces seen, `(n, L, 3)` in the unit and frame of `mean`; see `solve`."""
        coefficients, _, _ = self.solve(views)
        return _shapes(coefficients, *self._checked_model())

    def solve(self, views: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Fit the model to views.

        Args:
            views: `(n, L, 2)`, any scale and place, y up.

        Returns:
            `(n, K)` coefficients, `(n, 2, 4)` cameras that map `(x, y, z, 1)` to the view, and
            `(n,)` rounds taken.

        Raises:
            InputError: An unusable model, option or view.
        """
        mean, basis = self._checked_model()
        views = check_faces(views, "views", 2, len(mean))
        chunks = np.split(views, range(CHUNK, len(views), CHUNK))
        gram = gram_matrices(basis)
        fits = [self._solve_chunk(chunk, mean, basis, gram) for chunk in chunks]
        coefficients, cameras, rounds = map(np.concatenate, zip(*fits, strict=True))
        return coefficients, cameras, rounds

    def _solve_chunk(self, views, mean, basis, gram):
        noise = self.view_noise * np.ptp(views, axis=1).max(1)[:, None]
        coefficients = np.zeros((len(views), len(basis)))
        cameras = np.empty((len(views), 2, 4))
        rounds = np.zeros(len(views), int)
        moving = np.arange(len(views))
        while len(moving) and rounds.max() < self.max_iter:
            seen, before = views[moving], coefficients[moving]
            camera = _cameras(seen, _shapes(before, mean, basis), self.camera)
            seen_shape_noise = self.shape_noise * np.linalg.norm(camera[..., :3], axis=2)
            precision = 1 / (noise[moving] ** 2 + seen_shape_noise**2)
            after = solve_shape(camera, seen, mean, basis, precision, self.regularisation, gram)
            coefficients[moving], cameras[moving] = after, camera
            rounds[moving] += 1
            moving = moving[np.abs(after - before).max(1) > self.tol]
        return coefficients, cameras, rounds

    def _checked_model(self):
        mean = check_points(self.mean, "mean", 3)[0]
        extents = np.linalg.svd(mean - mean.mean(0), compute_uv=False)
        if extents[2] < FLAT * extents[0]:
            raise InputError("mean must not be flat. Received landmarks in one plane.")
        basis = np.asarray(self.basis_times_sd, float)
        if basis.ndim != 3 or basis.shape[1:] != mean.shape or not np.isfinite(basis).all():
            raise InputError(
                f"basis_times_sd must be finite, of shape (components, {len(mean)}, 3). "
                f"Received shape {basis.shape}."
            )
        if self.camera not in CAMERAS:
            raise InputError(
                f"camera must be one of {', '.join(CAMERAS)}. Received {self.camera!r}."
            )
        for name in ("view_noise", "regularisation", "max_iter"):
            if not getattr(self, name) > 0:
                raise InputError(f"{name} must be positive. Received {getattr(self, name)}.")
        return mean, basis


def _cameras(views, shapes, kind):
    """`(n, 2, 4)` cameras of that kind, mapping `(x, y, z, 1)` to the view."""
    if kind == "affine":
        return affine_cameras(views, shapes)
    rotations, scales, translations = orthographic_cameras(views, shapes)
    linear = scales[:, None, None] * rotations[:, :2]
    return np.concatenate([linear, translations[..., None]], axis=2)


def gram_matrices(basis_times_sd: np.ndarray) -> np.ndarray:
    """`(3, 3, K, K)` inner products of the components, one block for each pair of axes.

    The normal matrix of any camera is a weighted sum of these nine, so that no face needs its
    own projected basis squared.
    """
    axes = np.moveaxis(basis_times_sd, 2, 0)
    return axes[:, None] @ np.swapaxes(axes, 1, 2)[None]


def solve_shape(
    camera: np.ndarray,
    views: np.ndarray,
    mean: np.ndarray,
    basis_times_sd: np.ndarray,
    inverse_variance: np.ndarray | float,
    regularisation: float,
    gram: np.ndarray | None = None,
) -> np.ndarray:
    """Coefficients c that minimise |Omega^(1/2) (A c + b)|^2 + lambda |c|^2, in closed form.

    A is the basis and b the mean seen through the camera, b less the view.

    Args:
        camera: `(n, 2, 4)` affine cameras.
        views: `(n, L, 2)`.
        mean: `(L, 3)`.
        basis_times_sd: `(K, L, 3)`.
        inverse_variance: Diagonal of Omega: a number, or `(n, 2)` for the view's x and y.
        regularisation: lambda.
        gram: `gram_matrices(basis_times_sd)` where the caller has it already.

    Returns:
        `(n, K)` standard-normal coefficients.
    """
    n, k = len(views), len(basis_times_sd)
    linear, shift = camera[..., :3], camera[..., 3]
    gram = gram_matrices(basis_times_sd) if gram is None else gram
    weighted = np.broadcast_to(inverse_variance, (n, 2))[..., None] * linear
    axis_weights = np.swapaxes(linear, 1, 2) @ weighted
    normal = (axis_weights.reshape(n, 9) @ gram.reshape(9, k * k)).reshape(n, k, k)
    normal[:, range(k), range(k)] += regularisation
    residual = views - shift[:, None] - mean @ np.swapaxes(linear, 1, 2)
    back_projected = (residual @ weighted).reshape(n, -1)
    right = back_projected @ basis_times_sd.reshape(k, -1).T
    return np.linalg.solve(normal, right[..., None])[..., 0]


def _shapes(coefficients, mean, basis):
    return mean + (coefficients @ basis.reshape(len(basis), -1)).reshape(-1, *mean.shape)
