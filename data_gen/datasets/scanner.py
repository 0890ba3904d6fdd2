"""Range scans of posed faces: points of the visible surface, with a scanner's noise and holes."""

from __future__ import annotations

import numpy as np

from data_gen.models.mesh import triangle_corners, vertex_normals
from data_gen.rendering.rasteriser import Rasteriser

_NOISE_MM = 0.2  # s.d. along the line of sight, twice the makers' figure for a still target
_GRAZING = 0.25  # cosine below which a surface sends too little light back
_EYES = 0.5  # share of eyes that leave a hole
_EYE_MM = 7.0
_N_HOLES, _HOLES_MM = 3.0, (2.0, 7.0)  # mean number of others; their radii
_REACH_MM = 140.0  # what lies farther from the middle of the landmarks is cut off


class Scanner:
    """Scans posed meshes of the same triangles, as a triangulating laser scanner would.

    The figures are of the kind that CASIA-3D was taken with (Minolta VIVID 910: one view, about a
    point a millimetre, holes where the surface is dark, wet or seen at a grazing angle).

    Args:
        n_vertices: V.
        triangles: `(T, 3)` int, 0-based.
        pixels: Points in a row and in a column of the scan, about one a millimetre.

    Raises:
        InputError: The system library that draws is missing.
    """

    def __init__(self, n_vertices: int, triangles: np.ndarray, pixels: int = 2 * int(_REACH_MM)):
        self._triangles = triangles
        self._corners = triangle_corners(n_vertices, triangles)
        self._pixels = pixels
        self._rasteriser = Rasteriser(n_vertices, triangles, pixels, by_triangle=True)

    def scan(
        self,
        posed: np.ndarray,
        seen: np.ndarray,
        landmarks: np.ndarray,
        eyes: np.ndarray,
        rng: np.random.Generator,
    ) -> np.ndarray:
        """One scan.

        Args:
            posed: `(V, 3)` vertices as from `projections.in_camera_frame`, millimetres.
            seen: `(V, 3)` the same as from `projections.project_with_depth`: what hides what.
            landmarks: `(L, 3)` posed landmarks, whose middle the scanner is pointed at.
            eyes: `(2, 3)` posed middles of the eyes.
            rng: Source of noise and holes.

        Returns:
            `(n, 3)` points in the camera's frame, millimetres, about one a square millimetre.
        """
        middle = (landmarks.max(0) + landmarks.min(0)) / 2
        low = middle[:2] - _REACH_MM
        places = (seen[:, :2] - low) * (self._pixels / (2 * _REACH_MM))
        places[:, 1] = self._pixels - places[:, 1]
        number = self._rasteriser.draw_numbers(places, seen[:, 2])
        row, column = np.nonzero(number < len(self._triangles))
        hit = self._triangles[number[row, column]]
        weights = _barycentric(np.column_stack([column + 0.5, row + 0.5]), places[hit])
        points = np.einsum("nk,nkd->nd", weights, posed[hit])
        normals = vertex_normals(posed, self._triangles, self._corners)
        towards = np.einsum("nk,nk->n", weights, normals[hit][..., 2])
        kept = (towards > _GRAZING) & (np.linalg.norm(points - middle, axis=1) < _REACH_MM)
        points = points[kept]
        points = points[~_in_holes(points, eyes, rng)]
        points[:, 2] += rng.normal(0, _NOISE_MM, len(points))
        return points

    def close(self) -> None:
        """Free the window, as `Rasteriser.close`."""
        self._rasteriser.close()


def _barycentric(places: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Weights `(n, 3)` of the corners `(n, 3, 2)` of a triangle at places `(n, 2)` within it."""
    a, b, c = np.swapaxes(corners, 0, 1)
    u, v, w = b - a, c - a, places - a
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    area = np.where(area == 0, 1, area)
    second = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / area
    third = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / area
    # The middle of a pixel may lie a little outside of the triangle that is drawn there.
    weights = np.stack([1 - second - third, second, third], axis=1).clip(0, 1)
    return weights / weights.sum(1, keepdims=True)


def _in_holes(points: np.ndarray, eyes: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Mask `(n,)` of the points that fall into a hole: some eyes, and some places anywhere."""
    n = rng.poisson(_N_HOLES)
    centres = np.vstack(
        [eyes[rng.random(len(eyes)) < _EYES], points[rng.integers(len(points), size=n)]]
    )
    radii = np.append(np.full(len(centres) - n, _EYE_MM), rng.uniform(*_HOLES_MM, n))
    distance = np.linalg.norm(points[:, None] - centres, axis=2)
    return (distance < radii).any(1)
