"""Views of faces: random poses and cameras, and hidden landmarks; angles as in `Cameras`."""

import numpy as np

from data_gen.models.expressions import (
    SCAN_EXPRESSIONS,
    sample_expressions,
    scan_expression_weights,
)
from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.errors import check_choice
from deepmds_keras.geometry.camera import camera_angles
from deepmds_keras.geometry.views import (
    Cameras,
    about_axis,
    pose_and_project,
    project,
    sample_perspective_cameras,
)

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
    check_choice(protocol, "protocol", PROTOCOLS)
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
    tilted = camera_angles(about_axis(0, pitch) @ about_axis(2, roll))
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


def hidden_by_head(
    model: MorphableModel, scheme: str, identity: np.ndarray, cameras: Cameras
) -> np.ndarray:
    """Mask `(n, L)` of the landmarks that neutral heads `(n, K)` hide from their cameras, bool."""
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


def sample_photo_cameras(n: int, rng: np.random.Generator) -> Cameras:
    """Uniform poses to either side, in perspective: heads as in photos."""
    return sample_perspective_cameras(
        n, rng, yaw=YAW, pitch=PITCH, roll=ROLL, field_of_view=(0, FIELD_OF_VIEW)
    )


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
        detector_sd: Standard deviation in mm, per face `(n, 1, 1)` or one number.

    Returns:
        Views `(n, L, 2)` with the detector's errors and landmarks `(n, L, 3)`, both millimetres,
        and the cameras.

    Raises:
        InputError: The model has no such landmarks, or no expressions whose names are known.
    """
    part = model.at_landmarks(scheme)
    identity, expression = sample_expressive(model, n, rng)
    landmarks = part.shape(identity, expression)
    cameras = sample_photo_cameras(n, rng)
    views = project(landmarks, cameras)
    return views + rng.normal(0, detector_sd, views.shape), landmarks, cameras
