"""Meshes and clouds of points, as CoMA and CASIA-3D have them."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from deepmds_keras.geometry.views import in_camera_frame

# What a camera that looks along +z with y down has, from our frame.
HALF_TURN = np.array([1.0, -1.0, -1.0])


def scan_of(shape, triangles, camera, landmarks, rng, shoulders=False):
    """Points that a scanner at the origin sees of a head 1 m away, and of the shoulders below it.

    Shoulders are the front of an ellipsoid. Of each cell of 1.5 mm the nearest point is seen.
    """
    corners = shape[triangles]
    areas = np.linalg.norm(np.cross(*np.diff(corners, axis=1).swapaxes(0, 1)), axis=1)
    numbers = rng.choice(len(areas), 80_000, p=areas / areas.sum())
    weights = rng.dirichlet([1, 1, 1], len(numbers))
    points = np.einsum("nk,nkd->nd", weights, corners[numbers])
    points = in_camera_frame(points[None], camera)[0]
    if shoulders:
        x, y = rng.uniform(-1, 1, (2, 16_000))
        depth = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
        front = np.stack([x, y, depth], axis=1)[depth > 0.1] * (220, 90, 95)
        below = (0, rng.uniform(-290, -250), rng.uniform(-130, -70))
        nose = in_camera_frame(landmarks[None], camera)[0, 13]
        points = np.vstack([points, front + nose + below])
    points = points[np.argsort(-points[:, 2])]
    _, nearest = np.unique(points[:, :2] // 1.5 @ [1000, 1], return_index=True)
    return points[nearest] - (0, 0, 1000)


def hull(points):
    """Triangles of the convex hull of points about the origin, counter-clockwise from outside."""
    triangles = ConvexHull(points).simplices
    a, b, c = points[triangles.T]
    inwards = np.einsum("td,td->t", np.cross(b - a, c - a), a + b + c) < 0
    triangles[inwards] = triangles[inwards][:, ::-1]
    return triangles


def vrml(points):
    rows = ",\n".join(" ".join(map(repr, row)) for row in points.tolist())
    return f"#VRML V2.0 utf8\nShape {{ coord Coordinate {{ point [ {rows} ] }} }}\n"


def asc(points):
    return "\n".join(" ".join(map(repr, row)) for row in points.tolist())


def write_ply(file, vertices, triangles, faces="vertex_indices"):
    number = {"f4": "float", "f8": "double"}[vertices.dtype.str[1:]]
    header = [
        *("ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"),
        *(f"property {number} {axis}" for axis in "xyz"),
        *(f"element face {len(triangles)}", f"property list uchar int {faces}", "end_header", ""),
    ]
    rows = np.empty(len(triangles), [("n", "u1"), ("v", "<i4", (len(triangles[0]),))])
    rows["n"], rows["v"] = len(triangles[0]), triangles
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes("\n".join(header).encode() + vertices.tobytes() + rows.tobytes())
    return file
