"""Edges of an image, and which of them a line in it runs along."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull, KDTree

_LUMA = (0.299, 0.587, 0.114)  # Rec. 601
_SIGMA = 0.7  # pixels
# Shares of the steepest slope in the image: all pixels of an edge are above the first, one of them
# above the second. As MATLAB's `edge(image, "canny", 0.15)`, which Bas et al. call.
_WEAK, _STRONG = 0.06, 0.15
_FAINTEST = 2.0  # grey levels a pixel; a plain surface with a camera's noise has less


@dataclass(frozen=True, eq=False)
class ImageEdges:
    """Pixels of edges.

    Attributes:
        points: `(n, 2)` pixels, x right and y down, the middle of the first pixel being (0.5, 0.5).
        normals: `(n, 2)` unit vectors across the edges, from dark to bright.
    """

    points: np.ndarray
    normals: np.ndarray


def find_edges(image: np.ndarray) -> ImageEdges:
    """Edges by Canny's method (1986, doi:10.1109/TPAMI.1986.4767851), to a fraction of a pixel.

    The one of scikit-image does not tell in which direction an edge runs.

    Args:
        image: `(H, W, 3)` RGB, 0 to 255. One without any contrast has no edges.
    """
    grey = np.asarray(image, float) @ _LUMA
    dy, dx = (
        ndimage.gaussian_filter(grey, _SIGMA, order, mode="nearest") for order in ((1, 0), (0, 1))
    )
    slope = np.hypot(dx, dy)
    strong = max(_STRONG * slope.max(initial=0.0), _FAINTEST)
    rows, columns = np.nonzero(slope > strong * _WEAK / _STRONG)
    here = slope[rows, columns]
    normals = np.stack([dx[rows, columns], dy[rows, columns]], axis=1) / here[:, None]
    ahead, behind = (
        ndimage.map_coordinates(slope, np.stack([rows, columns]) + step.T[::-1], order=1)
        for step in (normals, -normals)
    )
    peak = (here >= ahead) & (here > behind)
    rows, columns, normals = rows[peak], columns[peak], normals[peak]
    here, ahead, behind = here[peak], ahead[peak], behind[peak]
    lines = np.zeros(slope.shape, bool)
    lines[rows, columns] = True
    line = ndimage.label(lines, np.ones((3, 3)))[0][rows, columns]
    kept = np.isin(line, line[here > strong])
    # The top of the parabola through the three slopes, at most half a pixel from the middle one.
    beyond = (ahead - behind) / (2 * (2 * here - ahead - behind))
    points = np.stack([columns, rows], axis=1) + 0.5 + beyond[:, None] * normals
    return ImageEdges(points[kept], normals[kept])


def edges_about(points: np.ndarray, image: np.ndarray, margin: float, n: int) -> ImageEdges:
    """Edges within the convex hull of some points, or near it.

    Args:
        points: `(k, 2)` pixels, x right and y down, not all on one line.
        image: `(H, W, 3)` RGB, 0 to 255.
        margin: Pixels beyond the hull.
        n: The image is made this many times smaller before, so that finer edges are not found.
    """
    low = np.maximum(np.int64(points.min(0) - margin), 0)
    high = np.maximum(np.int64(points.max(0) + margin) + 1, 0)
    part, n = image[low[1] : high[1], low[0] : high[0]], max(n, 1)
    rows, columns = part.shape[0] // n, part.shape[1] // n
    edges = find_edges(part[: rows * n, : columns * n].reshape(rows, n, columns, n, 3).mean((1, 3)))
    found = edges.points * n + low
    sides = ConvexHull(points).equations
    near = (found @ sides[:, :2].T + sides[:, 2]).max(1) < margin
    return ImageEdges(found[near], edges.normals[near])


class EdgeMatcher:
    """Finds the nearest of an image's edges that runs in much the same direction.

    Args:
        edges: Of the image.
        reach: Distance beyond which nothing is found, in units of the edges' points, the following
            counted in.
        turn: Distance that half a right angle between directions counts as, over the square root
            of 2. Which side is bright does not count.
    """

    def __init__(self, edges: ImageEdges, reach: float, turn: float):
        self._points, self._reach, self._turn = edges.points, reach, turn
        self._tree = KDTree(self._with_direction(edges.points, edges.normals))

    def match(self, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Edges for the points of a line.

        Args:
            points: `(n, 2)`.
            normals: `(n, 2)` unit vectors across the line.

        Returns:
            `(m,)` int, those of the points for which there is an edge, and `(m, 2)` where it is.
        """
        distances, found = self._tree.query(
            self._with_direction(points, normals), distance_upper_bound=self._reach
        )
        near = np.flatnonzero(np.isfinite(distances))
        return near, self._points[found[near]]

    def _with_direction(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        x, y = normals.T
        of_twice_the_angle = np.stack([x * x - y * y, 2 * x * y], axis=1)
        return np.concatenate([points, self._turn * of_twice_the_angle], axis=1)
