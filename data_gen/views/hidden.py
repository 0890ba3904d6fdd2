"""Landmarks that a view does not show, since the head itself is in front of them."""

from __future__ import annotations

import numpy as np

from data_gen.models.morphable_model import MorphableModel
from data_gen.views.projections import Cameras, in_camera_frame, project_with_depth

# Millimetres behind the surface from which a landmark counts as hidden: deeper than the folds of
# skin on whose rims people mark landmarks as if they saw them.
_BEHIND = 2.0
_CHUNK = 16  # whole meshes


def hidden_by_head(
    model: MorphableModel, scheme: str, identity: np.ndarray, cameras: Cameras
) -> np.ndarray:
    """Mask of the landmarks that neutral heads hide from their cameras, `(n, L)` bool.

    Args:
        model: Morphable model.
        scheme: Landmark scheme.
        identity: `(n, K)` standard-normal coefficients.
        cameras: One for each face.
    """
    landmarks = model.landmarks[scheme]
    hidden = np.empty((len(identity), len(landmarks)), bool)
    for start in range(0, len(identity), _CHUNK):
        faces = slice(start, start + _CHUNK)
        posed = in_camera_frame(model.shape(identity[faces]), cameras[faces])
        points = project_with_depth(posed, posed[:, landmarks], cameras[faces])
        hidden[faces] = [hidden_landmarks(own, model.triangles, landmarks) for own in points]
    return hidden


def hidden_landmarks(
    points: np.ndarray, triangles: np.ndarray, landmarks: np.ndarray, behind: float = _BEHIND
) -> np.ndarray:
    """Mask of the landmarks that the surface hides, `(L,)` bool.

    Args:
        points: `(V, 3)` vertices as from `project_with_depth`: x and y of the view, and depth that
            grows towards the viewer, millimetres.
        triangles: `(T, 3)` int, 0-based.
        landmarks: `(L,)` vertex numbers.
        behind: Depth behind the surface from which a landmark is hidden.
    """
    corners, ours = points[triangles], points[landmarks]
    low, high = corners[..., :2].min(1), corners[..., :2].max(1)
    # Sorted by x, the landmarks in the bounding box of a triangle are among a few neighbours.
    order = np.argsort(ours[:, 0])
    first, last = (
        np.searchsorted(ours[order, 0], bound[:, 0], side)
        for bound, side in ((low, "left"), (high, "right"))
    )
    triangle = np.repeat(np.arange(len(corners)), last - first)
    place_in_box = np.arange(len(triangle)) - np.repeat(
        np.cumsum(last - first) - last, last - first
    )
    landmark = order[place_in_box]
    y = ours[landmark, 1]
    over = (low[triangle, 1] <= y) & (y <= high[triangle, 1])
    triangle, landmark = triangle[over], landmark[over]
    a, b, c = np.swapaxes(corners[triangle], 0, 1)
    place = ours[landmark]
    area = _cross(b - a, c - a)
    # A triangle seen edge-on covers nothing.
    area = np.where(area == 0, np.nan, area)
    of_b, of_c = _cross(place - a, c - a) / area, _cross(b - a, place - a) / area
    covers = (of_b >= 0) & (of_c >= 0) & (of_b + of_c <= 1)
    depth = a[:, 2] + of_b * (b - a)[:, 2] + of_c * (c - a)[:, 2]
    hidden = np.zeros(len(landmarks), bool)
    hidden[landmark[covers & (depth > place[:, 2] + behind)]] = True
    return hidden


def _cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
