"""The pose of a head: how a 3D shape must be turned, scaled and moved to be seen as its view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from deepmds_keras.checks import check_points
from deepmds_keras.errors import InputError


@dataclass(frozen=True, eq=False)
class HeadPose:
    """A scaled orthographic camera, by the angles of the head that it sees.

    Yaw is positive when the head turns to its own left, pitch when it looks up, roll when its top
    leans towards its own right; they apply in this order. All are 0 from the front.

    Attributes:
        yaw, pitch, roll: Degrees.
        rotation: `(3, 3)`, to be multiplied from the left: from the frame of the shape to that of
            the camera, +x to the right of the view, +y up, +z towards the viewer.
        scale: Units of the view for a unit of the shape.
        translation: `(2,)` where the shape's origin is seen.
        residual: Root mean square distance of the projected shape from the view, in units of the
            larger side of the view's box.
    """

    yaw: float
    pitch: float
    roll: float
    rotation: np.ndarray
    scale: float
    translation: np.ndarray
    residual: float

    def project(self, shape: np.ndarray) -> np.ndarray:
        """Where points of the shape are seen: `(..., 3)` → `(..., 2)`, y up."""
        return self.scale * shape @ self.rotation[:2].T + self.translation


def head_pose(view: np.ndarray, shape: np.ndarray) -> HeadPose:
    """The scaled orthographic camera that sees a shape about as the view has it.

    The best affine camera, and of its matrix the nearest rotation times a scale (the POS algorithm
    of DeMenthon and Davis 1995, doi:10.1007/BF01450852, without its perspective iterations).

    Args:
        view: `(L, 2)` landmarks in the image, y up.
        shape: `(L, 3)` the same landmarks, +x to the subject's left, +y up, +z out of the face.

    Raises:
        InputError: Unequal numbers of landmarks, NaN, infinity or degenerate landmarks, or a view
            that no turned head gives: a mirrored one.
    """
    view, shape = check_points(view, "view", 2)[0], check_points(shape, "shape", 3)[0]
    if len(view) != len(shape):
        raise InputError(
            "view and shape must have the same landmarks. "
            f"Received {len(view)} and {len(shape)}."
        )
    centre, seen = shape.mean(0), view.mean(0)
    affine = np.linalg.lstsq(shape - centre, view - seen, rcond=None)[0].T
    u, sizes, vt = np.linalg.svd(affine, full_matrices=False)
    rows = u @ vt
    rotation = np.vstack([rows, np.cross(*rows)])
    if rotation[2, 2] <= 0:
        raise InputError(
            "view must show the face from in front, x to the right and y up. "
            "Received one that is mirrored, or seen from behind."
        )
    yaw, minus_pitch, roll = Rotation.from_matrix(rotation).as_euler("yxz", degrees=True)
    scale = float(sizes.mean())
    translation = seen - scale * rotation[:2] @ centre
    off = scale * shape @ rotation[:2].T + translation - view
    residual = np.sqrt((off**2).sum(1).mean()) / np.ptp(view, axis=0).max()
    return HeadPose(
        float(yaw), float(-minus_pitch), float(roll), rotation, scale, translation, float(residual)
    )
