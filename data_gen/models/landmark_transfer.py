"""Landmarks from one face model to another whose vertex numbering is unrelated.

A few points known on both (anchors) give a similarity and a thin-plate spline; the spline is then
refined so that the source surface falls on the target surface (TPS-ICP), and the landmarks that it
carried along take the nearest target vertices.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree

from data_gen.models.mesh import largest_component, vertex_normals
from deepmds_keras.alignment import procrustes
from deepmds_keras.errors import InputError

MIN_ANCHORS = 6
# Number of surface points, spline smoothing (mm), farthest match (mm): stiff and far-sighted first.
_ROUNDS = ((300, 300.0, 20.0), (300, 100.0, 15.0), (500, 30.0, 12.0), (800, 10.0, 10.0))
_REACH = 30.0  # mm around the landmarks: the part of the source surface that is fitted
_CANDIDATES = 12  # nearest target vertices looked at for each point


class Transfer(NamedTuple):
    """Where the landmarks went.

    Attributes:
        vertices: `(L,)` target vertex numbers, all distinct.
        snap: `(L,)` mm, from where a landmark was carried to the vertex that it took.
    """

    vertices: np.ndarray
    snap: np.ndarray


def transfer_landmarks(
    source_mean: np.ndarray,
    source_triangles: np.ndarray,
    source_landmarks: np.ndarray,
    source_anchors: np.ndarray,
    target_mean: np.ndarray,
    target_triangles: np.ndarray,
    target_anchors: np.ndarray,
) -> Transfer:
    """Finds the source's landmarks on the target's mean face.

    Args:
        source_mean: `(V, 3)` mm.
        source_triangles: `(T, 3)` int, counter-clockwise from outside.
        source_landmarks: `(L,)` source vertex numbers.
        source_anchors: `(A,)` source vertex numbers of points also known on the target, `A >= 6`,
            not in one plane.
        target_mean: `(W, 3)`, any unit and pose.
        target_triangles: `(U, 3)` int, counter-clockwise from outside.
        target_anchors: `(A,)` target vertex numbers of the same points.

    Raises:
        InputError: Too few anchors, or the surfaces do not meet near the landmarks.
    """
    n_anchors = len(source_anchors)
    if n_anchors < MIN_ANCHORS or len(target_anchors) != n_anchors:
        raise InputError(
            f"source_anchors and target_anchors must pair at least {MIN_ANCHORS} vertices. "
            f"Received {n_anchors} and {len(target_anchors)}."
        )
    for label, anchors in (
        ("source_anchors", source_mean[source_anchors]),
        ("target_anchors", target_mean[target_anchors]),
    ):
        extent = np.linalg.svd(anchors - anchors.mean(axis=0), compute_uv=False)
        if not extent[2] > 1e-3 * extent[0]:
            raise InputError(f"{label} must not lie in one plane. Received extents {extent}.")
    # The source is bent, so the target is brought to it: every length below is in the source's mm.
    rotation, scale, shift = procrustes(
        source_mean[source_anchors], target_mean[target_anchors], reflection=False
    )
    target_mean = (target_mean - shift) @ rotation.T / scale
    target = _Skin(target_mean, target_triangles)
    n_needed = max(len(source_landmarks), _CANDIDATES)
    if len(target.points) < n_needed:
        raise InputError(
            f"target_triangles must connect at least {n_needed} vertices. "
            f"Received {len(target.points)}."
        )
    anchors_to = target_mean[target_anchors]
    moved = _bend(source_mean, source_mean[source_anchors], anchors_to, smoothing=1.0)

    zone = _near_landmarks(source_mean, source_triangles, source_landmarks)
    for n_points, smoothing, reach in _ROUNDS:
        chosen = zone[_farthest_points(moved[zone], n_points)]
        normals = vertex_normals(moved, source_triangles)[chosen]
        feet, matched = target.feet(moved[chosen], normals, reach)
        if matched.mean() < 0.5:
            raise InputError(
                "target_mean must be a face of the same kind as source_mean in the pose that the "
                f"anchors give. Received one where {matched.sum()} of {len(chosen)} surface points "
                f"lie within {reach:g} mm."
            )
        moved = _bend(
            moved,
            np.concatenate([moved[chosen[matched]], moved[source_anchors]]),
            np.concatenate([feet[matched], anchors_to]),
            smoothing=smoothing,
        )
    nearest, snap = _distinct_nearest(moved[source_landmarks], target.tree)
    return Transfer(target.vertices[nearest], snap)


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
    spline = RBFInterpolator(
        source[once],
        (target - source)[once],
        kernel="thin_plate_spline",
        smoothing=smoothing,
    )
    return points + spline(points)


def _near_landmarks(mean, triangles, landmarks):
    skin = largest_component(len(mean), triangles)
    distance, _ = KDTree(mean[landmarks]).query(mean[skin])
    return skin[distance < _REACH]


def _farthest_points(points: np.ndarray, n: int) -> np.ndarray:
    """Indices of `n` points spread evenly: each is the farthest from those before it."""
    chosen = [0]
    distance = np.full(len(points), np.inf)
    for _ in range(min(n, len(points)) - 1):
        distance = np.minimum(distance, ((points - points[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(distance.argmax()))
    return np.array(chosen)


def _distinct_nearest(points: np.ndarray, tree: KDTree) -> tuple[np.ndarray, np.ndarray]:
    """A vertex of its own for each point, with the smallest sum of squared distances."""
    # As many candidates a point as there are points: nobody is left without one.
    candidates = np.unique(tree.query(points, k=len(points))[1])
    cost = ((points[:, None] - tree.data[candidates]) ** 2).sum(axis=2)
    _, choice = linear_sum_assignment(cost)
    return candidates[choice], np.sqrt(cost[np.arange(len(points)), choice])
