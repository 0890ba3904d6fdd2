"""Landmarks of a face model without a table, taken over from one that has it, by geometry.

A few points known on both (anchors) give a similarity and a thin-plate spline; the spline is then
refined so that the source surface falls on the target surface (TPS-ICP), and each landmark takes
the nearest target vertex.
"""

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree

from data_gen.models.mesh import largest_component, vertex_normals
from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.errors import InputError
from deepmds_keras.geometry.alignment import procrustes

MIN_ANCHORS = 6
# Number of surface points, spline smoothing (mm), farthest match (mm): stiff and far-sighted first.
_ROUNDS = ((300, 300.0, 20.0), (300, 100.0, 15.0), (500, 30.0, 12.0), (800, 10.0, 10.0))
_REACH = 30.0  # mm around the landmarks: the part of the source surface that is fitted
_CANDIDATES = 12  # nearest target vertices looked at for each point


def transfer_landmarks(
    source: MorphableModel,
    source_anchors: np.ndarray,
    target: MorphableModel,
    target_anchors: np.ndarray,
) -> np.ndarray:
    """Places the source's 72 landmarks (`"bfm72"`) on the target's mean face.

    Args:
        source: Face model with these landmarks, mm.
        source_anchors: `(A,)` source vertex numbers of `MIN_ANCHORS` or more points that are also
            known on the target, not in one plane.
        target: Face model in any unit and pose.
        target_anchors: `(A,)` target vertex numbers of the same points.

    Returns:
        `(72,)` target vertex numbers, all distinct.

    Raises:
        InputError: The anchors lie in one plane, or the surfaces do not meet near the landmarks.
    """
    landmarks = source.landmarks["bfm72"]
    anchors_from = source.mean[source_anchors]
    for label, anchors in (("source", anchors_from), ("target", target.mean[target_anchors])):
        extent = np.linalg.svd(anchors - anchors.mean(axis=0), compute_uv=False)
        if not extent[2] > 1e-3 * extent[0]:
            raise InputError(f"{label}_anchors must not lie in one plane. Received {extent}.")
    # The source is bent, so the target is brought to it: every length below is in the source's mm.
    rotation, scale, shift = procrustes(anchors_from, target.mean[target_anchors], reflection=False)
    target_mean = (target.mean - shift) @ rotation.T / scale
    surface = _Skin(target_mean, target.triangles)
    n_needed = max(len(landmarks), _CANDIDATES)
    if len(surface.points) < n_needed:
        raise InputError(
            f"target must connect at least {n_needed} vertices. Received {len(surface.points)}."
        )
    anchors_to = target_mean[target_anchors]
    moved = _bend(source.mean, anchors_from, anchors_to, smoothing=1.0)

    skin = largest_component(source.n_vertices, source.triangles)
    zone = skin[KDTree(source.mean[landmarks]).query(source.mean[skin])[0] < _REACH]
    for n_points, smoothing, reach in _ROUNDS:
        chosen = zone[_farthest_points(moved[zone], n_points)]
        normals = vertex_normals(moved, source.triangles)[chosen]
        feet, matched = surface.feet(moved[chosen], normals, reach)
        if matched.mean() < 0.5:
            raise InputError(
                "target must be a face of the same kind as source in the pose that the "
                f"anchors give. Received one where {matched.sum()} of {len(chosen)} surface points "
                f"lie within {reach:g} mm."
            )
        moved = _bend(
            moved,
            np.concatenate([moved[chosen[matched]], moved[source_anchors]]),
            np.concatenate([feet[matched], anchors_to]),
            smoothing=smoothing,
        )
    return surface.vertices[_distinct_nearest(moved[landmarks], surface.tree)]


class _Skin:
    """The largest connected part of a mesh: points, normals, and a tree to look them up."""

    def __init__(self, mean, triangles):
        self.vertices = largest_component(len(mean), triangles)
        self.points = mean[self.vertices]
        self.normals = vertex_normals(mean, triangles)[self.vertices]
        self.tree = KDTree(self.points)

    def feet(self, points, normals, reach):
        """Foot of each point on the nearest tangent plane that faces the same way, if any."""
        distance, near = self.tree.query(points, k=_CANDIDATES)
        fits = (np.einsum("nkd,nd->nk", self.normals[near], normals) > 0.5) & (distance < reach)
        best = near[np.arange(len(points)), fits.argmax(axis=1)]
        height = np.einsum("nd,nd->n", points - self.points[best], self.normals[best])
        return points - height[:, None] * self.normals[best], fits.any(axis=1)


def _bend(points, source, target, *, smoothing):
    """Moves points by the smoothing thin-plate spline that takes `source` to `target`."""
    # Two anchors may share a vertex, and a surface point may be one: the spline needs each once.
    _, once = np.unique(source.round(6), axis=0, return_index=True)
    moves = (target - source)[once]
    spline = RBFInterpolator(source[once], moves, kernel="thin_plate_spline", smoothing=smoothing)
    return points + spline(points)


def _farthest_points(points: np.ndarray, n: int) -> np.ndarray:
    """Indices of `n` points spread evenly: each is the farthest from those before it."""
    chosen = [0]
    distance = np.full(len(points), np.inf)
    for _ in range(min(n, len(points)) - 1):
        distance = np.minimum(distance, ((points - points[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(distance.argmax()))
    return np.array(chosen)


def _distinct_nearest(points: np.ndarray, tree: KDTree) -> np.ndarray:
    """Another vertex for each point, with the smallest sum of squared distances."""
    # As many candidates a point as there are points: no point is left without one.
    candidates = np.unique(tree.query(points, k=len(points))[1])
    cost = ((points[:, None] - tree.data[candidates]) ** 2).sum(axis=2)
    return candidates[linear_sum_assignment(cost)[1]]
