"""The paper's trivial case: one answer, the mean training shape, to every view."""

from __future__ import annotations

import numpy as np
from sklearn.base import BaseEstimator

from deepmds_keras.checks import check_faces, check_fitted, check_training_faces


class MeanShape(BaseEstimator):
    """The mean training shape, whatever the view.

    Attributes:
        mean_: `(L, 3)`.
    """

    def fit(self, views: np.ndarray, shapes: np.ndarray) -> MeanShape:
        """Take the mean.

        Args:
            views: `(n, L, 2)`, ignored but for their number.
            shapes: `(n, L, 3)` in one common frame and unit, such as that of `normalise`.

        Raises:
            InputError: NaN, infinity, degenerate or unequal numbers of landmarks.
        """
        _, shapes = check_training_faces(views, shapes)
        self.mean_ = shapes.mean(0)
        return self

    def predict(self, views: np.ndarray) -> np.ndarray:
        """`(n, L, 3)`: the mean, once for each of the `(n, L, 2)` views."""
        mean = check_fitted(self, "mean_")
        views = check_faces(views, "views", 2, len(mean))
        return np.tile(mean, (len(views), 1, 1))

    @property
    def n_parameters(self) -> int:
        return check_fitted(self, "mean_").size
