"""The fit of Aldrian and Smith 2013 as the paper's authors ran it, whose coefficients are off."""

from __future__ import annotations

import numpy as np
from sklearn.base import BaseEstimator

from deepmds_keras.baselines.aldrian import CHUNK, gram_matrices, solve_shape
from deepmds_keras.camera import affine_cameras
from deepmds_keras.checks import check_faces

_REGULARISATION = 1e-7
_ROUNDS = 50


class AldrianAuthors(BaseEstimator):
    """Camera and shape in turns, as in `Aldrian`, by the steps of the paper's released code.

    These differ from Aldrian and Smith's: the coefficients are solved for in the unit of the basis,
    with next to no prior; their mean and standard deviation over the components are then made 0
    and 1 for every face, and they are taken for standard normal ones. So every face differs from
    the mean by about as much. The variances that weigh landmarks come from scans that were not
    released: here all weigh alike.

    Args:
        mean: `(L, 3)` landmarks of the mean face, in any unit.
        basis_times_sd: `(K, L, 3)` offsets at one standard deviation, in the same unit.
        sd: `(K,)` standard deviation of each component, in the unit of the whole mesh.
    """

    def __init__(self, mean, basis_times_sd, sd):
        self.mean = mean
        self.basis_times_sd = basis_times_sd
        self.sd = sd

    @property
    def n_parameters(self) -> int:
        """Trainable parameters: none, the face model is given."""
        return 0

    def predict(self, views: np.ndarray) -> np.ndarray:
        """Shapes of the faces seen, in the unit and frame of `mean`.

        Args:
            views: `(n, L, 2)`, any scale and place, y up.

        Returns:
            `(n, L, 3)`.

        Raises:
            InputError: Views of another shape, NaN, infinity or degenerate ones.
        """
        views = check_faces(views, "views", 2, len(self.mean))
        chunks = np.split(views, range(CHUNK, len(views), CHUNK))
        return np.concatenate([self._predict_chunk(chunk) for chunk in chunks])

    def _predict_chunk(self, views):
        basis = self.basis_times_sd / self.sd[:, None, None]
        gram = gram_matrices(basis)
        shapes = np.broadcast_to(self.mean, (len(views), *self.mean.shape))
        for _ in range(_ROUNDS):
            cameras = affine_cameras(views, shapes)
            found = solve_shape(cameras, views, self.mean, basis, 1.0, _REGULARISATION, gram)
            found = (found - found.mean(1, keepdims=True)) / found.std(1, ddof=1, keepdims=True)
            shapes = self.mean + np.tensordot(found, self.basis_times_sd, 1)
        return shapes
