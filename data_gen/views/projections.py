"""Views of a face: random poses and projections as the paper describes, and as its code has them.

Angles are in degrees. Yaw is positive when the face turns to its own left (towards +x), pitch when
it looks up, roll when its top leans towards its own right; they apply in the order yaw, pitch,
roll, about the origin of the face.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepmds_keras.camera import camera_angles
from deepmds_keras.errors import InputError

PROJECTIONS = ("orthographic", "perspective")
PROTOCOLS = ("paper", "released", "posed")
_YAWS = (-45.0, 0.0, 45.0)
# Of the hard views: uniform, to either side, degrees; the field of view is that of a face from afar
# to so near that it fills a wide lens.
HARD_YAW, _HARD_PITCH, _HARD_ROLL, _HARD_FIELD_OF_VIEW = 60.0, 30.0, 20.0, 60.0


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


def sample_cameras(n: int, rng: np.random.Generator, protocol: str = "paper") -> Cameras:
    """Random poses and projections.

    `"paper"` (section "Datasets", BFM): the projection type is drawn evenly. Orthographic faces
    are turned by a yaw from {-45, 0, 45}; perspective ones are seen by a camera at an azimuth in
    [0, 45], towards the subject's left, and an elevation in [0, 30], with a field of view in
    [0, 5]. Seen from there the face is turned the other way: yaw and pitch are their negatives.

    `"posed"`, the other reading of that section: faces seen in perspective are turned by a yaw
    from {-45, 0, 45} too, and the camera goes round the turned face.

    `"released"` (the authors' generator): 40 % of the faces are frontal, 30 % turned by a yaw from
    {-45, 0, 45} and 30 % go through MATLAB's `viewmtx`. Its camera looks along z, so that its
    azimuth acts as a roll in [-45, 45] and its elevation as a pitch in [0, 30]. Nothing is divided
    by the fourth homogeneous coordinate: these are orthographic views under the name perspective.

    Args:
        n: Number of faces.
        rng: Source of the random numbers.
        protocol: One of `PROTOCOLS`.

    Raises:
        InputError: Unknown protocol.
    """
    if protocol not in PROTOCOLS:
        raise InputError(f"protocol must be one of {', '.join(PROTOCOLS)}. Received {protocol!r}.")
    # Every number is drawn for every face, so that a face keeps its pose whatever the others are.
    draw = rng.random(n)
    turn = rng.choice(_YAWS, n)
    azimuth, elevation, angle = (rng.uniform(0, high, n) for high in (45, 30, 5))
    none = np.zeros(n)
    if protocol != "released":
        perspective = draw < 0.5
        posed = turn if protocol == "posed" else none
        return Cameras(
            projection=perspective.astype(int),
            yaw=np.where(perspective, posed - azimuth, turn),
            pitch=np.where(perspective, -elevation, none),
            roll=none,
            field_of_view=np.where(perspective, angle, none),
        )
    through_viewmtx = draw < 0.3
    turned = (draw >= 0.3) & (draw < 0.6)
    # The roll comes first there, the pitch after it.
    roll, pitch = (np.deg2rad(a) for a in (2 * azimuth - 45, elevation))
    tilted = camera_angles(_about(0, -pitch) @ _about(2, roll))
    yaw, pitch, roll = np.where(through_viewmtx, tilted, 0.0)
    return Cameras(
        projection=through_viewmtx.astype(int),
        yaw=np.where(turned, turn, yaw),
        pitch=pitch,
        roll=roll,
        field_of_view=none,
    )


def sample_hard_cameras(n: int, rng: np.random.Generator) -> Cameras:
    """Random poses and projections beyond the paper's: far turned, tilted, leaning and from near.

    Yaw in [-60, 60], pitch in [-30, 30], roll in [-20, 20], all uniform; half of the views are
    orthographic, the others have a field of view in [0, 60].

    Args:
        n: Number of faces.
        rng: Source of the random numbers.
    """
    yaw, pitch, roll = (rng.uniform(-most, most, n) for most in (HARD_YAW, _HARD_PITCH, _HARD_ROLL))
    perspective = rng.random(n) < 0.5
    angle = rng.uniform(0, _HARD_FIELD_OF_VIEW, n)
    return Cameras(perspective.astype(int), yaw, pitch, roll, np.where(perspective, angle, 0.0))


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
        np.full(n, PROJECTIONS.index("perspective")),
        *(rng.uniform(-most, most, n) for most in (yaw, pitch, roll)),
        rng.uniform(*field_of_view, n),
    )


def rotations(cameras: Cameras) -> np.ndarray:
    """Rotation matrices of the faces, `(n, 3, 3)`, to be multiplied from the left."""
    yaw, pitch, roll = (np.deg2rad(a) for a in (cameras.yaw, cameras.pitch, cameras.roll))
    return _about(2, roll) @ _about(0, -pitch) @ _about(1, yaw)


def in_camera_frame(points: np.ndarray, cameras: Cameras) -> np.ndarray:
    """The faces as posed: +x to the right of the image, +z towards the viewer, `(n, L, 3)`.

    Args:
        points: `(n, L, 3)` millimetres.
        cameras: One for each face.
    """
    return points @ np.swapaxes(rotations(cameras), 1, 2)


def project(points: np.ndarray, cameras: Cameras) -> np.ndarray:
    """Views of the faces: `(n, L, 3)` → `(n, L, 2)`, millimetres in the plane of the face, y up.

    The perspective camera looks at the middle of the landmarks from where their bounding sphere
    fills the field of view. It scales the plane through that middle to its true size. With the
    field of view going to 0 the view tends to the orthographic one.

    Args:
        points: `(n, L, 3)` millimetres.
        cameras: One for each face.
    """
    posed = in_camera_frame(points, cameras)
    return project_with_depth(posed, posed, cameras)[..., :2]


def project_with_depth(posed: np.ndarray, landmarks: np.ndarray, cameras: Cameras) -> np.ndarray:
    """Any points of the faces, such as all vertices, by the cameras that see their landmarks.

    Args:
        posed: `(n, V, 3)` points as from `in_camera_frame`.
        landmarks: `(n, L, 3)` likewise, that each camera is set up by, see `project`.
        cameras: One for each face.

    Returns:
        `(n, V, 3)` x and y as from `project`, and a depth that grows towards the viewer. The map is
        projective: planes stay planes, so that what hides what can be told from the depth.
    """
    middle = (landmarks.max(1, keepdims=True) + landmarks.min(1, keepdims=True)) / 2
    radius = np.linalg.norm(landmarks - middle, axis=-1).max(1)
    inverse_distance = np.sin(np.deg2rad(cameras.field_of_view) / 2) / radius
    centred = posed - middle
    nearness = 1 - centred[..., 2:] * inverse_distance[:, None, None]
    return centred / nearness + middle


def _about(axis: int, angle: np.ndarray) -> np.ndarray:
    """Right-handed rotations about one coordinate axis: `(n,)` radians → `(n, 3, 3)`."""
    cosine, sine = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrices = np.zeros((len(angle), 3, 3))
    matrices[:, axis, axis] = 1
    matrices[:, i, i] = matrices[:, j, j] = cosine
    matrices[:, i, j], matrices[:, j, i] = -sine, sine
    return matrices
