"""Compared methods that solve linear equations; none of them needs TensorFlow."""

from dataclasses import KW_ONLY, dataclass
from typing import Self

import numpy as np
from sklearn.base import BaseEstimator
from sklearn.linear_model import RidgeCV

from deepmds_keras.errors import InputError, brief
from deepmds_keras.geometry.alignment import align
from deepmds_keras.geometry.camera import affine_cameras
from deepmds_keras.geometry.units import rescaled
from deepmds_keras.validation import (
    as_numbers,
    check_basis,
    check_face_model,
    check_faces,
    check_fitted,
    check_number,
    check_views_and_shapes,
    check_whole,
    of_one_or_many,
)

CHUNK = 256  # faces solved together: bounds the memory of their equations to about 80 MB
_AUTHORS_REGULARISATION = 1e-7
_AUTHORS_ROUNDS = 50


class MeanShape(BaseEstimator):
    """The mean training shape, whatever the view.

    Attributes:
        mean_: `(L, 3)`.
    """

    def fit(self, views: np.ndarray, shapes: np.ndarray) -> Self:
        """Take the mean of `(n, L, 3)` shapes in one frame and unit; views are only checked.

        Raises:
            InputError: NaN, infinity, degenerate or unequal numbers of landmarks.
        """
        self.mean_ = check_views_and_shapes(views, shapes)[1].mean(0)
        return self

    def predict(self, views: np.ndarray) -> np.ndarray:
        """`(n, L, 3)`: the mean, once for each of the `(n, L, 2)` views; one for `(L, 2)`."""
        mean = check_fitted(self, "mean_")
        n = len(check_faces(views, "views", 2, len(mean)))
        return of_one_or_many(np.tile(mean, (n, 1, 1)), views)

    @property
    def n_parameters(self) -> int:
        """Number of fitted parameters."""
        return check_fitted(self, "mean_").size


@dataclass(eq=False, repr=False)
class RidgeRegression(BaseEstimator):
    """One linear map from all 2L coordinates of a view to all 3L of the shape, with intercept.

    A learnt method must beat it to justify not being linear. The penalty is the one in `alphas`
    with the least leave-one-out error on the training faces, in closed form.

    Args:
        alphas: Penalties to choose from, positive, for views and shapes in `normalise`'s unit.
        roll_aligned: Whether each view is first rotated in its plane, shifted and scaled onto the
            frontal view of the mean training shape.

    Attributes:
        front_: `(L, 2)` x and y of that mean.
        ridge_: Fitted `sklearn.linear_model.RidgeCV`; `ridge_.alpha_` is the penalty chosen.
        n_landmarks_: L.
    """

    alphas: tuple[float, ...] = tuple(10.0**k for k in range(-9, 3))
    roll_aligned: bool = False

    def fit(self, views: np.ndarray, shapes: np.ndarray) -> Self:
        """Solve for `(n, L, 2)` views and `(n, L, 3)` shapes; errors as `MeanShape.fit`."""
        views, shapes = check_views_and_shapes(views, shapes)
        alphas = as_numbers(self.alphas, "alphas")
        if alphas.ndim != 1 or not len(alphas) or not (np.isfinite(alphas) & (alphas > 0)).all():
            raise InputError(
                f"alphas must be one or more finite and positive numbers. Received {brief(alphas)}."
            )
        front = shapes.mean(0)[:, :2]
        ridge = RidgeCV(alphas).fit(self._flat(views, front), shapes.reshape(len(shapes), -1))
        self.n_landmarks_, self.front_, self.ridge_ = len(front), front, ridge
        return self

    def predict(self, views: np.ndarray) -> np.ndarray:
        """Shapes of the views, in the frame and unit of the training.

        `(n, L, 2)` gives `(n, L, 3)`, and one view `(L, 2)` gives `(L, 3)`.
        """
        ridge = check_fitted(self, "ridge_")
        faces = check_faces(views, "views", 2, self.n_landmarks_)
        shapes = ridge.predict(self._flat(faces, self.front_)).reshape(len(faces), -1, 3)
        return of_one_or_many(shapes, views)

    def _flat(self, views: np.ndarray, front: np.ndarray) -> np.ndarray:
        if self.roll_aligned:
            views = align(views, np.broadcast_to(front, views.shape), reflection=False)
        return views.reshape(len(views), -1)

    @property
    def n_parameters(self) -> int:
        """Number of fitted parameters."""
        ridge = check_fitted(self, "ridge_")
        return ridge.coef_.size + ridge.intercept_.size


@dataclass(eq=False, repr=False)
class _ModelFit(BaseEstimator):
    """Fit of a morphable model's coefficients to views; a subclass has `_solve`."""

    mean: np.ndarray
    basis_times_sd: np.ndarray
    n_parameters = 0  # none are trained: the face model is given

    def predict(self, views: np.ndarray) -> np.ndarray:
        """`(n, L, 3)` or `(L, 3)` shapes in the unit and frame of `mean`.

        Args:
            views: `(n, L, 2)` or `(L, 2)`, any scale and place, y up.

        Raises:
            InputError: An unusable model, option or view.
        """
        mean, basis = check_face_model(self.mean, self.basis_times_sd)
        faces = check_faces(views, "views", 2, len(mean))
        chunks = np.split(faces, range(CHUNK, len(faces), CHUNK))
        coefficients = np.concatenate([self._solve(chunk, mean, basis) for chunk in chunks])
        return of_one_or_many(_shapes(coefficients, mean, basis), views)


@dataclass(eq=False, repr=False)
class Aldrian(_ModelFit):
    """Shape coefficients of a morphable model and an affine camera, by alternating solves.

    Aldrian and Smith 2013 (doi:10.1109/TPAMI.2012.206), geometric part. The first camera sees the
    mean face. Coefficients are standard normal, so with the true noise each solve is a maximum a
    posteriori estimate.

    An affine camera can explain part of the identity (stretched or sheared faces), where only the
    prior decides. The rounds creep along that valley, more slowly the less noise is assumed.
    `max_iter` stops them before they converge, and too small a `view_noise` then does harm, since
    the first, wrong cameras are fitted too closely.

    Args:
        mean: `(L, 3)` landmarks of the mean face, in any unit.
        basis_times_sd: `(K, L, 3)` offsets at one standard deviation, in the same unit.
        view_noise: Standard deviation of the view's coordinates, as a part of the larger side of
            its bounding box. The default is eos's, sqrt(3) pixels, on a face of 500 pixels.
        max_iter: Maximum number of rounds of camera and shape; by default that of the paper's code.
        tol: A face is finished once no coefficient moves by more than this in a round.
    """

    _: KW_ONLY
    view_noise: float = 3.5e-3
    max_iter: int = 50
    tol: float = 1e-4

    def _solve(self, views, mean, basis):
        check_number(self.view_noise, "view_noise")
        check_whole(self.max_iter, "max_iter")
        check_number(self.tol, "tol", zero=True)
        views, _ = rescaled(views)
        noise = self.view_noise * np.ptp(views, axis=1).max(1)[:, None]
        products = inner_products(basis)
        coefficients = np.zeros((len(views), len(basis)))
        moving = np.arange(len(views))
        for _ in range(self.max_iter):
            seen, before = views[moving], coefficients[moving]
            cameras = affine_cameras(seen, _shapes(before, mean, basis))
            after = solve_shape(cameras, seen, mean, basis, noise[moving] ** 2, products)
            coefficients[moving] = after
            moving = moving[np.abs(after - before).max(1) > self.tol]
            if not len(moving):
                break
        return coefficients


@dataclass(eq=False, repr=False)
class AldrianAuthors(_ModelFit):
    """The fit of Aldrian and Smith as the paper's authors ran it, whose coefficients are off.

    As `Aldrian`, but by the steps of the paper's released code: coefficients are solved for in the
    unit of the basis, almost without a prior, then standardised to mean 0 and standard deviation 1
    over the components of each face, two or more, and used as standard normal ones. Hence every
    face differs from the mean by about the same amount. The variances that weight the landmarks
    come from scans that were not released: here all weights are equal.

    Args:
        mean, basis_times_sd: As for `Aldrian`.
        sd: `(K,)` standard deviation of each component, in the unit of the whole mesh.
    """

    sd: np.ndarray

    def _solve(self, views, mean, basis):
        check_basis(basis, "basis_times_sd", len(mean), least=2)  # one has no s.d.
        sd = as_numbers(self.sd, "sd")
        if sd.shape != (len(basis),) or not (np.isfinite(sd) & (sd > 0)).all():
            raise InputError(
                f"sd must be {len(basis)} finite and positive numbers. Received {brief(sd)}."
            )
        raw_basis = basis / sd[:, None, None]
        products = inner_products(raw_basis)
        views, exponents = rescaled(views)
        # In the square of that unit; beyond 2^400, nothing else counts.
        variance = np.ldexp(_AUTHORS_REGULARISATION, np.minimum(-2 * exponents[:, 0], 400))
        c = np.zeros((len(views), len(basis)))
        for _ in range(_AUTHORS_ROUNDS):
            cameras = affine_cameras(views, _shapes(c, mean, basis))
            c, _ = rescaled(solve_shape(cameras, views, mean, raw_basis, variance, products), 1)
            c = (c - c.mean(1, keepdims=True)) / c.std(1, ddof=1, keepdims=True)
        return c


def inner_products(basis_times_sd: np.ndarray) -> np.ndarray:
    """Inner products of the K components, or of the L landmarks, one block per pair of axes.

    The matrix of any camera's equations is a weighted sum of these nine, which saves projecting and
    squaring the basis for each face.

    Returns:
        `(3, 3, K, K)`, or `(3, 3, L, L)` if a view has fewer coordinates than the model components.
    """
    axes = np.moveaxis(basis_times_sd, 2, 0)
    _, k, n_landmarks = axes.shape
    if 2 * n_landmarks < k:
        axes = np.swapaxes(axes, 1, 2)
    return axes[:, None] @ np.swapaxes(axes, 1, 2)[None]


def solve_shape(camera, views, mean, basis_times_sd, variance, products) -> np.ndarray:
    """Coefficients c, `(n, K)`, that minimise |A c - b|^2 + variance |c|^2.

    A is the basis and b the offset from the mean, both as the camera sees them. Of two equal
    systems the smaller one is solved: (A^T A + variance I) c = A^T b, or c = A^T d with
    (A A^T + variance I) d = b.

    Args:
        camera, views: `(n, 2, 4)` affine cameras and what they see, `(n, L, 2)`.
        mean, basis_times_sd: `(L, 3)` and `(K, L, 3)`.
        variance: Of the noise of a coordinate: a number, or `(n, 1)` of each face.
        products: `inner_products(basis_times_sd)`.
    """
    n, k, size = len(views), len(basis_times_sd), products.shape[-1]
    linear, shift = camera[..., :3], camera[..., 3]

    def back_project(image):
        return (image @ linear).reshape(n, -1) @ basis_times_sd.reshape(k, -1).T

    def solve(matrices, right):
        diagonal = range(matrices.shape[1])
        matrices[:, diagonal, diagonal] += variance
        return np.linalg.solve(matrices, right[..., None])[..., 0]

    offset = views - shift[:, None] - mean @ np.swapaxes(linear, 1, 2)
    if size == k:
        weights = np.swapaxes(linear, 1, 2) @ linear
        normal = weights.reshape(n, 9) @ products.reshape(9, -1)
        return solve(normal.reshape(n, k, k), back_project(offset))
    weights = linear[:, :, None, :, None] * linear[:, None, :, None, :]
    seen = (weights.reshape(n, 4, 9) @ products.reshape(9, -1)).reshape(n, 2, 2, size, size)
    seen = seen.swapaxes(2, 3).reshape(n, 2 * size, 2 * size)
    trusted = solve(seen, np.swapaxes(offset, 1, 2).reshape(n, -1))
    return back_project(np.swapaxes(trusted.reshape(n, 2, size), 1, 2))


def _shapes(coefficients, mean, basis):
    return mean + (coefficients @ basis.reshape(len(basis), -1)).reshape(-1, *mean.shape)
