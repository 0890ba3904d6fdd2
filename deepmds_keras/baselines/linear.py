"""Ridge regression from the coordinates of a view to those of the shape."""

from __future__ import annotations

import numpy as np
from sklearn.base import BaseEstimator
from sklearn.linear_model import RidgeCV

from deepmds_keras.checks import check_faces, check_fitted, check_training_faces


class Linear(BaseEstimator):
    """One linear map from all 2L coordinates of a view to all 3L of the shape, with intercept.

    What a learnt method has to beat to justify that it is not linear. The penalty is the one of
    `alphas` with the least leave-one-out error on the training faces, in closed form.

    Args:
        alphas: Penalties to choose from, for views and shapes in the unit of `normalise`.

    Attributes:
        ridge_: Fitted `sklearn.linear_model.RidgeCV`; `ridge_.alpha_` is the penalty chosen.
        n_landmarks_: L.
    """

    def __init__(self, alphas=(1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)):
        self.alphas = alphas

    def fit(self, views: np.ndarray, shapes: np.ndarray) -> Linear:
        """Solve the normal equations.

        Args:
            views: `(n, L, 2)` normalised views.
            shapes: `(n, L, 3)` normalised shapes.

        Raises:
            InputError: NaN, infinity, degenerate or unequal numbers of landmarks.
        """
        views, shapes = check_training_faces(views, shapes)
        n, self.n_landmarks_ = views.shape[:2]
        self.ridge_ = RidgeCV(np.asarray(self.alphas)).fit(
            views.reshape(n, -1), shapes.reshape(n, -1)
        )
        return self

    def predict(self, views: np.ndarray) -> np.ndarray:
        """`(n, L, 3)` shapes of the `(n, L, 2)` views, in the frame and unit of the training."""
        ridge = check_fitted(self, "ridge_")
        views = check_faces(views, "views", 2, self.n_landmarks_)
        return ridge.predict(views.reshape(len(views), -1)).reshape(len(views), -1, 3)

    @property
    def n_parameters(self) -> int:
        ridge = check_fitted(self, "ridge_")
        return ridge.coef_.size + ridge.intercept_.size
