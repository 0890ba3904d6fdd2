"""Cameras that see given shapes as given views: pose of a head, orientation of an embedding."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.geometry.units import rescaled
from deepmds_keras.validation import as_numbers, check_views_and_shapes

_STEEP = 1e-7  # cosine of the pitch of a head seen from straight above or below


@dataclass(frozen=True, eq=False)
class HeadPose:
    """The camera that sees a face, or the cameras of n faces: every array is then `(n, ...)`.

    Attributes:
        rotation: `(3, 3)`, multiplied from the left: from the frame of the shape to that of the
            camera, +x to the right of the view, +y up, +z towards the viewer.
        scale: View units per shape unit, at the depth of the shape's origin.
        translation: `(2,)` position of the shape's origin in the view.
        perspective: Inverse distance of the camera from the shape's origin, in shape units; 0 for
            a scaled orthographic camera.
        residual: Root mean square distance between the projected shape and the view, relative to
            the larger side of the view's bounding box; NaN if unknown.
    """

    rotation: np.ndarray
    scale: float | np.ndarray
    translation: np.ndarray
    perspective: float | np.ndarray = 0.0
    residual: float | np.ndarray = np.nan

    @property
    def yaw(self) -> float | np.ndarray:
        """Degrees, positive when the head turns to its left; the first turn."""
        return self.as_dict()["yaw"]

    @property
    def pitch(self) -> float | np.ndarray:
        """Degrees, positive when the head looks up; the second turn."""
        return self.as_dict()["pitch"]

    @property
    def roll(self) -> float | np.ndarray:
        """Degrees, positive when its top leans to its right; the last turn."""
        return self.as_dict()["roll"]

    def project(self, shape: np.ndarray) -> np.ndarray:
        """Project points of the shape: `(..., 3)` → `(..., 2)`, y up; n cameras take n shapes."""
        scale, perspective, translation = self.scale, self.perspective, self.translation
        if np.ndim(self.rotation) == 3:
            scale, perspective = np.reshape(scale, (-1, 1, 1)), np.reshape(perspective, (-1, 1, 1))
            translation = translation[:, None]
        posed = shape @ np.swapaxes(self.rotation, -1, -2)
        near = 1 / (1 - perspective * posed[..., 2:])
        return scale * near * posed[..., :2] + translation

    def as_dict(self) -> dict[str, float | np.ndarray]:
        """Angles and attributes by name, in the order in which files list them."""
        angles = camera_angles(np.reshape(self.rotation, (-1, 3, 3)))
        angles = angles if np.ndim(self.rotation) == 3 else angles[:, 0].tolist()
        return dict(zip(("yaw", "pitch", "roll"), angles, strict=True)) | vars(self)

    def __bool__(self) -> bool:
        """True: without this Python would ask for the length, which the pose of one face lacks."""
        return True

    def __len__(self) -> int:
        if np.ndim(self.rotation) != 3:
            raise TypeError("This HeadPose is of one face.")
        return len(self.rotation)

    def __getitem__(self, index: int | slice | np.ndarray) -> HeadPose:
        """Pose of one of the n faces, or of several."""
        len(self)  # raises TypeError if this is the pose of one face
        values = vars(self).values()
        return HeadPose(*(value[index] if np.ndim(value) else value for value in values))


def affine_cameras(views: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Affine cameras of n faces, fitted to their views by least squares.

    A flat shape does not determine its camera; the solution of least norm is taken. Views
    `(n, L, 2)` and shapes `(n, L, 3)` give `(n, 2, 4)`, mapping `(x, y, z, 1)` to the view.
    """
    seen, centre = views.mean(1, keepdims=True), shapes.mean(1, keepdims=True)
    linear = np.linalg.pinv(shapes - centre) @ (views - seen)
    return np.swapaxes(np.concatenate([linear, seen - centre @ linear], axis=1), 1, 2)


def orthographic_cameras(views: np.ndarray, shapes: np.ndarray) -> HeadPose:
    """Scaled orthographic cameras of views `(n, L, 2)` and shapes `(n, L, 3)`.

    Each is the scaled rotation nearest to the affine camera (the POS algorithm of DeMenthon and
    Davis 1995, doi:10.1007/BF01450852, without its perspective iterations). Minimising the
    distances in the image over rotations would be worse: shapes are estimates, and the pitch of a
    nearly frontal one would then depend mostly on their errors.
    """
    linear = np.swapaxes(affine_cameras(views, shapes)[..., :3], 1, 2)
    u, sizes, vt = np.linalg.svd(linear, full_matrices=False)
    rows = np.swapaxes(u @ vt, 1, 2)
    rotations = np.concatenate([rows, np.cross(rows[:, :1], rows[:, 1:])], axis=1)
    scales = sizes.mean(1)
    seen = scales[:, None] * np.einsum("nrd,nd->nr", rows, shapes.mean(1))
    return HeadPose(rotations, scales, views.mean(1) - seen)


def refit(poses: HeadPose, views: np.ndarray, shapes: np.ndarray) -> HeadPose:
    """Fit scale and translation of n cameras to their views by least squares; keep the rotations.

    Each camera keeps its distance, measured in sizes of the face. Views are `(n, L, 2)`, y up, NaN
    where a landmark is missing; shapes `(n, L, 3)`.
    """
    posed = shapes @ np.swapaxes(poses.rotation, 1, 2)
    seen = ~np.isnan(views[..., :1])
    n_seen, views = seen.sum(1), np.where(seen, views, 0)
    scale, perspective = np.asarray(poses.scale), np.asarray(poses.perspective)
    for _ in range(2):  # the perspective hardly depends on the scale
        flat = seen * posed[..., :2] / (1 - perspective[:, None, None] * posed[..., 2:])
        flat_middle, middle = flat.sum(1) / n_seen, views.sum(1) / n_seen
        off = seen * (flat - flat_middle[:, None])
        before, scale = scale, (off * views).sum((1, 2)) / (off**2).sum((1, 2))
        perspective = perspective * scale / before
    translation = middle - scale[:, None] * flat_middle
    return replace(poses, scale=scale, translation=translation, perspective=perspective)


def camera_angles(rotations: np.ndarray) -> np.ndarray:
    """Yaw, pitch and roll of heads in degrees: `(n, 3, 3)` → `(3, n)`.

    Rotations are those of `HeadPose`, `R = R_z(roll) R_x(-pitch) R_y(yaw)`. Seen from straight
    above or below, yaw and roll are indistinguishable, and the whole turn counts as yaw.
    """
    (right, up_x, front), (_, up_y, _), (side, up, ahead) = np.moveaxis(rotations, 0, 2)
    steepness = np.hypot(side, ahead)
    level = ~(steepness <= _STEEP)  # NaN, of a gap, stays NaN
    yaw = np.arctan2(*np.where(level, (-side, ahead), (front, right)))
    roll = np.where(level, np.arctan2(-up_x, up_y), 0.0)
    return np.rad2deg([yaw, -np.arctan2(up, steepness), roll])


def head_pose(view: np.ndarray, shape: np.ndarray) -> HeadPose:
    """The scaled orthographic camera under which a shape best resembles its view.

    Args:
        view: `(L, 2)` landmarks in the image, y up.
        shape: `(L, 3)` the same landmarks, +x to the subject's left, +y up, +z out of the face.

    Returns:
        Its pose, with `scale` and `translation` in the unit of the view, and the residual.

    Raises:
        InputError: Unequal numbers of landmarks, NaN, infinity or degenerate landmarks, several
            faces, or a mirrored view, which no turned head gives.
    """
    view, shape = as_numbers(view, "view"), as_numbers(shape, "shape")
    if view.ndim != 2 or shape.ndim != 2:
        raise InputError(
            "view and shape must be of one face, (L, 2) and (L, 3). "
            f"Received shapes {view.shape} and {shape.shape}."
        )
    pose = head_poses(view, shape)[0]
    if pose.rotation[2, 2] <= 0:
        raise InputError(
            "view must show the face from the front, x to the right and y up. "
            "Received a face that is mirrored or seen from behind."
        )
    return pose


def head_poses(views: np.ndarray, shapes: np.ndarray) -> HeadPose:
    """`head_pose` of n faces as one `HeadPose`; a mirrored view gives a head seen from behind."""
    views, shapes = check_views_and_shapes(views, shapes)
    poses = orthographic_cameras(views, shapes)
    off, exponents = rescaled(poses.project(shapes) - views)
    off = np.ldexp(np.sqrt((off**2).sum(2).mean(1)), exponents[:, 0, 0])
    return replace(poses, residual=off / np.ptp(views, axis=1).max(1))
