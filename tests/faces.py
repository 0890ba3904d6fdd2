"""Cameras, rotations and the mean face, as several test modules take them."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from data_gen.models.openhead import load_openhead
from deepmds_keras.geometry.views import Cameras, rotations


def cameras(yaw=0.0, pitch=0.0, roll=0.0, field_of_view=0.0) -> Cameras:
    """Of angles in degrees, each one or many; orthographic without a field of view."""
    angles = (yaw, pitch, roll, field_of_view)
    angles = np.broadcast_arrays(*(np.ravel(angle).astype(float) for angle in angles))
    return Cameras((angles[3] > 0).astype(int), *angles)


def rotation_of(yaw=0.0, pitch=0.0, roll=0.0) -> np.ndarray:
    """Rotation `(3, 3)` of a face that is turned by degrees."""
    return rotations(cameras(yaw, pitch, roll))[0]


def degrees_between(first, second) -> np.ndarray:
    """Angles between rotations `(..., 3, 3)`."""
    turns = np.swapaxes(first, -1, -2) @ second
    return np.rad2deg(Rotation.from_matrix(turns).magnitude())


def mean_landmarks(scheme) -> np.ndarray:
    """Those of the open head, `(L, 3)` millimetres."""
    head = load_openhead()
    return head.mean[head.landmarks[scheme]]
