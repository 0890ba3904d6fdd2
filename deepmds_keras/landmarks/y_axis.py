"""Direction of y in landmarks: distinguishes flipped axes from a face that leans or turns."""

from functools import cache

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.geometry.units import rms_radius
from deepmds_keras.landmarks import convert, face_sizes, load_scheme, scheme_of

_PARTS = ("right_eye", "left_eye", "outer_mouth")
# In sizes of the face (root mean square distance from its middle): how far the eyes must be below
# the mouth, and how far apart on the wrong sides. From the front the mean face's are 1.3 to 1.5
# above the mouth and 1.2 to 1.4 apart. In profile they are 0 apart, up to 0.47 on the wrong sides
# when the face is near the camera and nods by 40 degrees; those of a mirrored face turned by 60
# degrees are 0.63.
_BELOW, _SWAPPED = 0.2, 0.5
_ROTATED = (
    "the face must be upright; turn it, and its photo, by 180 degrees. Received landmarks whose "
    "eyes lie below the mouth, the right eye to the right."
)
_EYES_BELOW = "Received landmarks whose eyes lie below the mouth."
# What the command line advises, without and with `--y-up`.
Y_UP_ADVICE = {
    False: "y must point down; pass --y-up if it points up.",
    True: "y must point up for --y-up; omit it if y points down.",
}
_NEGATE_Y = "y must point up; negate it if it points down, as in images."
_MIRRORED = (
    "x must point right, and right and left be the subject's; mirror x, or swap right and "
    "left landmarks. Received a mirrored face."
)


def check_y_axis(
    landmarks: np.ndarray, scheme: str, name: str, *, needed: str = Y_UP_ADVICE[False]
) -> dict[int, str]:
    """Refuse landmarks if most of the faces are upside down or mirrored.

    Then y grows upwards, or right and left are swapped. A batch is judged as a whole: single faces
    may be oriented oddly. Eyes and mouth decide: the eyes must be above the mouth, and seen from
    the mouth towards the eyes, the subject's right eye must be on the left. A face may lean by
    nearly 90 degrees. Profiles pass, whichever side they show; faces that lack a landmark of the
    eyes or of the outer mouth are not judged.

    Args:
        landmarks: `(n, L, 2)` or `(L, 2)`, x to the right of the image and y down; finite or NaN.
        name: Name of the file or argument, for the message.
        needed: What the message says of a wrong y.

    Returns:
        Number of each face with an odd orientation, 0-based and ascending, → what is wrong.

    Raises:
        InputError: The landmarks do not have the scheme's shape, or most faces are not upright. The
            message says which of the three faults it is, how to mend it, and the first such face.
    """
    faces, across, down = _eyes_and_mouth(landmarks, scheme)
    # The signed area that the two vectors span is negative for a mirrored face, however it leans.
    area = across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0]
    faults = {}
    for face in np.flatnonzero((down[:, 1] < 0) | (area < 0)).tolist():  # few, if any
        size = rms_radius(faces[face][~np.isnan(faces[face]).any(1)])
        least = _SWAPPED * size * np.linalg.norm(down[face])
        upside_down = down[face, 1] < -_BELOW * size
        if upside_down and area[face] > least:
            faults[face] = _ROTATED
        elif upside_down or area[face] < -least:
            faults[face] = f"{needed} {_EYES_BELOW}" if upside_down else _MIRRORED
    if 2 * len(faults) > np.isfinite(area).sum():
        face, fault = next(iter(faults.items()))
        n = len(faces)
        raise InputError(f"{f'{name}, face {face + 1} of {n}' if n > 1 else name}: {fault}")
    return faults


def check_views(views: np.ndarray) -> None:
    """`check_y_axis` for views `(n, L, 2)` whose y grows upwards; those of an unknown scheme pass.

    Raises:
        InputError: y grows downwards, or most faces are mirrored or upside down.
    """
    if views.shape[1] not in face_sizes():
        return
    try:
        check_y_axis(views * (1, -1), scheme_of(views.shape[1]), "views", needed=_NEGATE_Y)
    except InputError as error:
        raise InputError(
            f"{error} With check_orientation=False they are taken as they are."
        ) from None


def quarter_turns(landmarks: np.ndarray, scheme: str) -> np.ndarray:
    """Number of quarter turns to the left, as `np.rot90` makes, that bring each face upright.

    Args:
        landmarks: `(n, L, 2)` as for `check_y_axis`.

    Returns:
        `(n,)` int, -2 to 2: 0 for a face that leans by less than 45 degrees.

    Raises:
        InputError: The landmarks do not have the scheme's shape.
    """
    _, _, down = _eyes_and_mouth(landmarks, scheme)
    lean = np.arctan2(-down[:, 0], down[:, 1])
    return np.rint(np.nan_to_num(lean) / (np.pi / 2)).astype(int)


def eyes_to_mouth(landmarks: np.ndarray, scheme: str) -> np.ndarray:
    """Vectors from the middle of the eyes to that of the mouth: `(n, L, 2)` → `(n, 2)`."""
    return _eyes_and_mouth(landmarks, scheme)[2]


def _eyes_and_mouth(
    landmarks: np.ndarray, scheme: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Landmarks, shifted, and the vectors from the right eye to the left, and to the mouth."""
    judged = scheme if {*_PARTS} <= {*load_scheme(scheme).groups} else "ibug51"
    faces = convert(landmarks, scheme, judged, missing="nan")[..., :2]
    faces = faces[None] if faces.ndim == 2 else faces
    # Rounding, which differs between processors, would give landmarks that coincide a direction.
    faces = faces - np.fmin.reduce(faces, axis=1, keepdims=True)
    # Of a part that is not known the vectors are NaN; what belongs to none may be missing.
    middles = _middles(load_scheme(judged).groups)
    parts = np.where(np.any(middles, axis=0)[:, None], faces, 0)
    right, left, mouth = (middles @ parts).swapaxes(0, 1)
    return faces, left - right, mouth - (right + left) / 2


@cache
def _middles(groups: tuple[str, ...]) -> np.ndarray:
    """`(3, L)`: multiplied by landmarks it gives the middles of the three parts."""
    members = np.array([np.array(groups) == part for part in _PARTS], float)
    return members / members.sum(1, keepdims=True)
