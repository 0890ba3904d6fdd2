"""The scaled orthographic camera of the fits, and how what it sees changes with pose and shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

N_POSE = 6  # rotation vector, logarithm of the scale, translation


@dataclass(frozen=True, eq=False)
class OrthographicCamera:
    """A camera far away, to which a millimetre is as large wherever it is.

    Attributes:
        rotation: `(3, 3)` from the frame of the model to the camera's, to be multiplied from the
            left: +x to the right of the image, +y up, +z towards the viewer.
        scale: Pixels per millimetre.
        translation: `(2,)` pixels, y up, where the origin is seen.
    """

    rotation: np.ndarray
    scale: float
    translation: np.ndarray

    def project(self, points: np.ndarray) -> np.ndarray:
        """`(..., 3)` millimetres → `(..., 2)` pixels, y up."""
        return self.scale * points @ self.rotation[:2].T + self.translation

    def jacobian(self, points: np.ndarray, basis: np.ndarray) -> np.ndarray:
        """Derivatives of the projected points: `(6 + K, n, 2)`.

        Args:
            points: `(n, 3)` millimetres.
            basis: `(K, n, 3)` how they move with each coefficient.

        Returns:
            By the `N_POSE` numbers of `moved`, then by the coefficients.
        """
        by_pose = np.zeros((N_POSE, len(points), 2))
        x, y, z = self.scale * self.rotation @ points.T
        by_pose[1, :, 0], by_pose[2, :, 0] = z, -y
        by_pose[0, :, 1], by_pose[2, :, 1] = -z, x
        by_pose[3, :, 0], by_pose[3, :, 1] = x, y
        by_pose[4, :, 0] = by_pose[5, :, 1] = 1
        return np.concatenate([by_pose, self.scale * basis @ self.rotation[:2].T])

    def moved(self, step: np.ndarray) -> OrthographicCamera:
        """The camera after a step: rotation vector, logarithm of the scale, translation."""
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        return OrthographicCamera(
            turn @ self.rotation, self.scale * np.exp(step[3]), self.translation + step[4:6]
        )
