"""Cameras that see given shapes as given views, affine or scaled orthographic: a head's pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deepmds_keras.checks import check_points
from deepmds_keras.errors import InputError

_STEEP = 1e-7  # cosine of the pitch of a head seen from straight above or below


class OrthographicCameras(NamedTuple):
    """Scaled orthographic cameras: `view = scale * (shape @ rotation.T)[:, :2] + translation`.

    Attributes:
        rotations: `(n, 3, 3)`, of determinant 1, to be multiplied from the left.
        scales: `(n,)` units of the view for a unit of the shape.
        translations: `(n, 2)` where the shape's origin is seen.
    """

    rotations: np.ndarray
    scales: np.ndarray
    translations: np.ndarray


def affine_cameras(views: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Return the affine camera of each face that has the least squared distances in its view.

    Centring is all that is kept of the normalising similarities of the normalised DLT: without
    a projective row they change the rounding of the solution, not the solution. Of a flat shape,
    which leaves the camera open, the smallest is taken.

    Args:
        views: `(n, L, 2)`.
        shapes: `(n, L, 3)`.

    Returns:
        `(n, 2, 4)`, mapping `(x, y, z, 1)` to the view.
    """
    seen, centre = views.mean(1, keepdims=True), shapes.mean(1, keepdims=True)
    linear = np.linalg.pinv(shapes - centre) @ (views - seen)
    return np.swapaxes(np.concatenate([linear, seen - centre @ linear], axis=1), 1, 2)


def orthographic_cameras(views: np.ndarray, shapes: np.ndarray) -> OrthographicCameras:
    """Return the scaled orthographic camera of each face that is nearest to its affine one.

    Of the affine camera's matrix, the nearest rotation times a scale (the POS algorithm of
    DeMenthon and Davis 1995, doi:10.1007/BF01450852, without its perspective iterations). To
    minimise the distances in the image over rotations instead would not do: shapes are estimates,
    and the pitch of a nearly frontal one then depends on their errors most.

    Args:
        views: `(n, L, 2)`.
        shapes: `(n, L, 3)`.
    """
    linear = np.swapaxes(affine_cameras(views, shapes)[..., :3], 1, 2)
    u, sizes, vt = np.linalg.svd(linear, full_matrices=False)
    rows = np.swapaxes(u @ vt, 1, 2)
    rotations = np.concatenate([rows, np.cross(rows[:, :1], rows[:, 1:])], axis=1)
    scales = sizes.mean(1)
    seen = scales[:, None] * np.einsum("nrd,nd->nr", rows, shapes.mean(1))
    return OrthographicCameras(rotations, scales, views.mean(1) - seen)


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


def camera_angles(rotations: np.ndarray) -> np.ndarray:
    """Yaw, pitch and roll of heads in degrees: `(n, 3, 3)` → `(3, n)`.

    Yaw turns first, roll last, so that `R = R_z(roll) R_x(-pitch) R_y(yaw)`. From straight above or
    below, yaw is as good as roll, and all of the turn is yaw.

    Args:
        rotations: From the frame of the face to the camera's, to be multiplied from the left.
    """
    (right, up_x, front), (_, up_y, _), (side, up, ahead) = np.moveaxis(rotations, 0, 2)
    steepness = np.hypot(side, ahead)
    level = steepness > _STEEP
    yaw = np.arctan2(*np.where(level, (-side, ahead), (front, right)))
    roll = np.where(level, np.arctan2(-up_x, up_y), 0.0)
    return np.rad2deg([yaw, -np.arctan2(up, steepness), roll])


def head_pose(view: np.ndarray, shape: np.ndarray) -> HeadPose:
    """The scaled orthographic camera that sees a shape about as the view has it.

    Args:
        view: `(L, 2)` landmarks in the image, y up.
        shape: `(L, 3)` the same landmarks, +x to the subject's left, +y up, +z out of the face.

    Raises:
        InputError: Unequal numbers of landmarks, NaN, infinity or degenerate landmarks, several
            faces, or a view that no turned head gives: a mirrored one.
    """
    if np.ndim(view) != 2 or np.ndim(shape) != 2:
        raise InputError(
            "view and shape must be of one face, (L, 2) and (L, 3). "
            f"Received shapes {np.shape(view)} and {np.shape(shape)}."
        )
    (pose,) = head_poses(view, shape)
    if pose.rotation[2, 2] <= 0:
        raise InputError(
            "view must show the face from in front, x to the right and y up. "
            "Received one that is mirrored, or seen from behind."
        )
    return pose


def head_poses(views: np.ndarray, shapes: np.ndarray) -> list[HeadPose]:
    """`head_pose` of many faces; one that is mirrored comes out as seen from behind.

    Args:
        views: `(n, L, 2)`, y up.
        shapes: `(n, L, 3)` as for `head_pose`.

    Raises:
        InputError: Unequal numbers, NaN, infinity or degenerate landmarks.
    """
    views, shapes = check_points(views, "view", 2), check_points(shapes, "shape", 3)
    if views.shape[:2] != shapes.shape[:2]:
        raise InputError(
            "view and shape must have the same faces and landmarks. "
            f"Received {views.shape[:2]} and {shapes.shape[:2]}."
        )
    rotations, scales, translations = orthographic_cameras(views, shapes)
    projected = scales[:, None, None] * (shapes @ np.swapaxes(rotations[:, :2], 1, 2))
    off = projected + translations[:, None] - views
    residuals = np.sqrt((off**2).sum(2).mean(1)) / np.ptp(views, axis=1).max(1)
    return [
        HeadPose(*angle, rotation, scale, translation, residual)
        for angle, rotation, scale, translation, residual in zip(
            camera_angles(rotations).T.tolist(),
            rotations,
            scales.tolist(),
            translations,
            residuals.tolist(),
            strict=True,
        )
    ]
