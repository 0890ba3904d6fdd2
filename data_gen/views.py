"""Views of faces: random poses and cameras, projections, and hidden landmarks.

Angles are in degrees. Yaw is positive when the face turns to its left (towards +x), pitch when it
looks up, roll when its top leans to its right; they apply in the order yaw, pitch, roll, about the
origin of the face.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_gen.models.expressions import (
    SCAN_EXPRESSIONS,
    sample_expressions,
    scan_expression_weights,
)
from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.errors import InputError
from deepmds_keras.geometry.camera import camera_angles
from deepmds_keras.geometry.units import rms_radius

PROJECTIONS = ("orthographic", "perspective")
PROTOCOLS = ("paper", "released", "posed")
_YAWS = (-45.0, 0.0, 45.0)
# Of the hard views: uniform, to either side, degrees; the field of view is that of a face from afar
# to so near that it fills a wide lens.
HARD_YAW, _HARD_PITCH, _HARD_ROLL, _HARD_FIELD_OF_VIEW = 60.0, 30.0, 20.0, 60.0
# Of photos: likewise; the field of view is that of a head from afar to arm's length.
YAW, PITCH, ROLL, FIELD_OF_VIEW = 50.0, 25.0, 30.0, 25.0
# Standard deviation of each coordinate. dlib's errors are 2 to 4 % of the 90 mm between the outer
# corners of the eyes, in photos and renders.
DETECTOR_SD_MM = 3.0
# Depth in mm behind the surface at which a landmark counts as hidden: more than the folds of skin
# on whose rims people mark landmarks as if they saw them.
_BEHIND = 2.0
_CHUNK = 16  # whole meshes


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
    azimuth acts as a roll in [-45, 45] and its elevation as a pitch in [-30, 0]. Nothing is divided
    by the fourth homogeneous coordinate: these are orthographic views under the name perspective.

    Raises:
        InputError: The protocol is none of `PROTOCOLS`.
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
    # The roll comes first there, the pitch after it. Faces look down: on such views the authors'
    # networks have a third of the error that they have on faces that look up as far.
    roll, pitch = (np.deg2rad(a) for a in (2 * azimuth - 45, elevation))
    tilted = camera_angles(_about(0, pitch) @ _about(2, roll))
    yaw, pitch, roll = np.where(through_viewmtx, tilted, 0.0)
    yaw = np.where(turned, turn, yaw)
    return Cameras(through_viewmtx.astype(int), yaw, pitch, roll, field_of_view=none)


def sample_hard_cameras(n: int, rng: np.random.Generator) -> Cameras:
    """Random poses and projections beyond the paper's: larger angles, and cameras close by.

    Yaw in [-60, 60], pitch in [-30, 30], roll in [-20, 20], all uniform; half of the views are
    orthographic, the others have a field of view in [0, 60].
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
    """Points of the faces as posed: +x to the right of the image, +z towards the viewer.

    Args:
        points: `(n, L, 3)` millimetres, like the result.
        cameras: One for each face.
    """
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
        cameras: One for each face.

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
    """Inverse distance, times its r.m.s. radius, at which a face fills each field of view, `(n,)`.

    Args:
        fields_of_view: `(n,)` degrees.
        mean: `(L, 3)` landmarks of the face.
    """
    return rms_radius(mean[None]) * _filling(mean[None], fields_of_view)[1]


def _filling(landmarks: np.ndarray, fields_of_view: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middle of faces `(n, 1, 3)`, and inverse distances from which they fill fields of view."""
    middle = (landmarks.max(1, keepdims=True) + landmarks.min(1, keepdims=True)) / 2
    radius = np.linalg.norm(landmarks - middle, axis=-1).max(1)
    return middle, np.sin(np.deg2rad(fields_of_view) / 2) / radius


def _about(axis: int, angle: np.ndarray) -> np.ndarray:
    """Right-handed rotations about one coordinate axis: `(n,)` radians → `(n, 3, 3)`."""
    cosine, sine = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrices = np.zeros((len(angle), 3, 3))
    matrices[:, axis, axis] = 1
    matrices[:, i, i] = matrices[:, j, j] = cosine
    matrices[:, i, j], matrices[:, j, i] = -sine, sine
    return matrices


def hidden_by_head(
    model: MorphableModel, scheme: str, identity: np.ndarray, cameras: Cameras
) -> np.ndarray:
    """Mask of the landmarks of a scheme that neutral heads hide from their cameras, `(n, L)` bool.

    Args:
        identity: `(n, K)` standard-normal coefficients.
        cameras: One for each face.
    """
    landmarks = model.landmarks[scheme]
    hidden = np.empty((len(identity), len(landmarks)), bool)
    for start in range(0, len(identity), _CHUNK):
        faces = slice(start, start + _CHUNK)
        shapes = model.shape(identity[faces])
        _, points = pose_and_project(shapes, shapes[:, landmarks], cameras[faces])
        hidden[faces] = [hidden_landmarks(face, model.triangles, landmarks) for face in points]
    return hidden


def hidden_landmarks(
    points: np.ndarray, triangles: np.ndarray, landmarks: np.ndarray
) -> np.ndarray:
    """Mask of the landmarks that the surface hides, `(L,)` bool.

    Args:
        points: `(V, 3)` projected vertices, see `pose_and_project`.
        triangles: `(T, 3)` int, 0-based.
        landmarks: `(L,)` vertex numbers.
    """
    corners = points[triangles]
    (left, low), (right, high) = (f(corners[..., :2], axis=1).T.copy() for f in (np.min, np.max))
    hidden = np.zeros(len(landmarks), bool)
    for landmark, place in enumerate(points[landmarks]):
        x, y, z = place
        over = (left <= x) & (x <= right) & (low <= y) & (y <= high)
        a, b, c = np.swapaxes(corners[over], 0, 1)
        area = _cross(b - a, c - a)
        # A triangle seen edge-on covers nothing.
        area = np.where(area == 0, np.nan, area)
        of_b, of_c = _cross(place - a, c - a) / area, _cross(b - a, place - a) / area
        covers = (of_b >= 0) & (of_c >= 0) & (of_b + of_c <= 1)
        depth = a[:, 2] + of_b * (b - a)[:, 2] + of_c * (c - a)[:, 2]
        hidden[landmark] = (covers & (depth > z + _BEHIND)).any()
    return hidden


def _cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]


def sample_expressive(
    model: MorphableModel, n: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of random faces in any expression.

    Identities are standard normal. Half of the expressions are moments of performances, half are
    held ones, and two thirds of all are at full strength.

    Returns:
        `(n, K)` of identity and `(n, E)` of expression.

    Raises:
        InputError: The model has no expressions whose names are known.
    """
    identity = rng.standard_normal((n, model.n_identity))
    performed = sample_expressions(model, n, rng)
    held = scan_expression_weights(model, rng.choice(SCAN_EXPRESSIONS, n), rng)
    expression = np.where(rng.random((n, 1)) < 0.5, performed, held)
    return identity, expression * np.minimum(1, 3 * rng.random((n, 1)))


def sample_photo_views(
    model: MorphableModel,
    scheme: str,
    n: int,
    rng: np.random.Generator,
    *,
    detector_sd: float | np.ndarray = DETECTOR_SD_MM,
) -> tuple[np.ndarray, np.ndarray, Cameras]:
    """Random expressive faces in any pose, one view of each, with a detector's errors.

    Args:
        model: Morphable model with named expressions and landmarks of the scheme.
        detector_sd: Standard deviation in mm, per face `(n, 1, 1)` or one number.

    Returns:
        Views `(n, L, 2)` with the detector's errors and landmarks `(n, L, 3)`, both millimetres,
        and the cameras.

    Raises:
        InputError: The model has no such landmarks, or no expressions whose names are known.
    """
    if scheme not in model.landmarks:
        raise InputError(
            f"scheme must be one of {', '.join(model.landmarks)} for {model.name}. "
            f"Received {scheme!r}."
        )
    part = model.restrict(model.landmarks[scheme])
    identity, expression = sample_expressive(model, n, rng)
    landmarks = part.shape(identity, expression)
    cameras = sample_perspective_cameras(
        n, rng, yaw=YAW, pitch=PITCH, roll=ROLL, field_of_view=(0, FIELD_OF_VIEW)
    )
    views = project(landmarks, cameras)
    return views + rng.normal(0, detector_sd, views.shape), landmarks, cameras
