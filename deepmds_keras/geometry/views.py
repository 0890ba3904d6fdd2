"""Views of shapes: random poses and cameras, and projections.

Angles are in degrees. Yaw is positive when a face turns to its left (towards +x), pitch when it
looks up, roll when its top leans to its right; they apply in the order yaw, pitch, roll, about the
origin of the shape.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.geometry.units import rms_radius
from deepmds_keras.validation import check_number, check_points, check_whole

PROJECTIONS = ("orthographic", "perspective")


@dataclass(frozen=True, eq=False)
class Cameras:
    """Camera of each of `n` faces.

    Attributes:
        projection: `(n,)` int, index into `PROJECTIONS`.
        yaw, pitch, roll: `(n,)` degrees.
        field_of_view: `(n,)` degrees, the angle that the face fills; 0 is orthographic.
    """

    projection: np.ndarray
    yaw: np.ndarray
    pitch: np.ndarray
    roll: np.ndarray
    field_of_view: np.ndarray

    def __len__(self) -> int:
        return len(self.projection)

    def __getitem__(self, faces) -> Cameras:
        return Cameras(*(value[faces] for value in vars(self).values()))


def sample_perspective_cameras(
    n: int,
    rng: np.random.Generator,
    *,
    yaw: float,
    pitch: float,
    roll: float,
    field_of_view: tuple[float, float],
) -> Cameras:
    """Uniform poses, to either side, and fields of view from one angle to another, degrees."""
    return Cameras(
        projection=np.full(n, PROJECTIONS.index("perspective")),
        yaw=rng.uniform(-yaw, yaw, n),
        pitch=rng.uniform(-pitch, pitch, n),
        roll=rng.uniform(-roll, roll, n),
        field_of_view=rng.uniform(*field_of_view, n),
    )


def sample_views(
    shapes: np.ndarray,
    n_views: int = 40,
    *,
    yaw: float = 180.0,
    pitch: float = 90.0,
    roll: float = 180.0,
    field_of_view: float = 25.0,
    noise: float = 0.0,
    rng: np.random.Generator | int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Random views of given shapes, for `LandmarkLifter.fit`; by default from all sides.

    Args:
        shapes: `(n, L, 3)` in any unit, +y up, and +z towards the viewer at yaw and pitch 0.
        n_views: Number of views of each shape.
        yaw, pitch, roll: Largest angles in degrees, to either side; each view draws its own.
        field_of_view: Largest angle in degrees that a shape fills in the camera, below 180; each
            view draws its own. 0 is an orthographic camera; 25 is a head at arm's length.
        noise: Standard deviation of the errors of a coordinate of a view, in the unit of the
            shapes. Tell `fit` of it: `landmark_sd=noise`.
        rng: Random generator, or its seed.

    Returns:
        Views `(n n_views, L, 2)`, y up, in the unit of the shapes, and the shape of each,
        `(n n_views, L, 3)`; those of one shape lie together.

    Raises:
        InputError: Shapes that are not finite or degenerate, or a number out of range.

    Examples:
        >>> import numpy as np
        >>> chairs = np.random.default_rng(0).normal(size=(100, 14, 3))
        >>> views, shown = sample_views(chairs, 5, pitch=30, noise=0.01)
        >>> views.shape, shown.shape
        ((500, 14, 2), (500, 14, 3))
    """
    shapes = check_points(shapes, "shapes", 3)
    check_whole(n_views, "n_views")
    most = {"yaw": yaw, "pitch": pitch, "roll": roll}
    for name, value in {**most, "field_of_view": field_of_view, "noise": noise}.items():
        check_number(value, name, zero=True)
    if field_of_view >= 180:
        raise InputError(f"field_of_view must be less than 180. Received {field_of_view}.")
    if not isinstance(rng, np.random.Generator):
        check_whole(rng, "rng", 0)
    rng, shown = np.random.default_rng(rng), np.repeat(shapes, n_views, axis=0)
    views = project(
        shown,
        sample_perspective_cameras(len(shown), rng, **most, field_of_view=(0, field_of_view)),
    )
    return views + noise * rng.standard_normal(views.shape), shown


def rotations(cameras: Cameras) -> np.ndarray:
    """Rotation matrices of the faces, `(n, 3, 3)`, to be multiplied from the left."""
    yaw, pitch, roll = (np.deg2rad(a) for a in (cameras.yaw, cameras.pitch, cameras.roll))
    return about_axis(2, roll) @ about_axis(0, -pitch) @ about_axis(1, yaw)


def in_camera_frame(points: np.ndarray, cameras: Cameras) -> np.ndarray:
    """Points `(n, L, 3)` of the faces as posed: +x to the right of the image, +z to the viewer."""
    return points @ np.swapaxes(rotations(cameras), 1, 2)


def project(points: np.ndarray, cameras: Cameras) -> np.ndarray:
    """Views of the faces: `(n, L, 3)` → `(n, L, 2)`, millimetres in the plane of the face, y up.

    The perspective camera looks at the middle of the landmarks from where their bounding sphere
    fills the field of view. It scales the plane through that middle to its true size. With the
    field of view going to 0 the view tends to the orthographic one.
    """
    return pose_and_project(points, points, cameras)[1][..., :2]


def pose_and_project(
    points: np.ndarray, landmarks: np.ndarray, cameras: Cameras
) -> tuple[np.ndarray, np.ndarray]:
    """Pose and project any points of the faces, such as all vertices, for a renderer.

    Args:
        points: `(n, V, 3)` millimetres, in the frame of the face.
        landmarks: `(n, L, 3)` likewise, which define each camera, see `project`.

    Returns:
        `(n, V, 3)` as from `in_camera_frame`; and `(n, V, 3)` x and y as from `project`, with a
        depth that grows towards the viewer. That map is projective: planes stay planes, so that
        the depth shows what hides what.
    """
    posed = in_camera_frame(points, cameras)
    landmarks = posed if landmarks is points else in_camera_frame(landmarks, cameras)
    middle, inverse_distance = _filling(landmarks, cameras.field_of_view)
    centred = posed - middle
    nearness = 1 - centred[..., 2:] * inverse_distance[:, None, None]
    return posed, centred / nearness + middle


def perspectives(fields_of_view: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Inverse distances at which a face `(L, 3)` fills fields of view, `(n,)` degrees → `(n,)`.

    They are times the r.m.s. radius of the face.
    """
    return rms_radius(mean[None]) * _filling(mean[None], fields_of_view)[1]


def _filling(landmarks: np.ndarray, fields_of_view: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middle of faces `(n, 1, 3)`, and inverse distances from which they fill fields of view."""
    middle = (landmarks.max(1, keepdims=True) + landmarks.min(1, keepdims=True)) / 2
    radius = np.linalg.norm(landmarks - middle, axis=-1).max(1)
    return middle, np.sin(np.deg2rad(fields_of_view) / 2) / radius


def about_axis(axis: int, angle: np.ndarray) -> np.ndarray:
    """Right-handed rotations about one coordinate axis: `(n,)` radians → `(n, 3, 3)`."""
    cosine, sine = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrices = np.zeros((len(angle), 3, 3))
    matrices[:, axis, axis] = 1
    matrices[:, i, i] = matrices[:, j, j] = cosine
    matrices[:, i, j], matrices[:, j, i] = -sine, sine
    return matrices
