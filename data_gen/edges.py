"""Edges of an image, those that the outline of a model has in a view, and which go together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull, KDTree

from data_gen.models.morphable_model import MorphableModel

_LUMA = (0.299, 0.587, 0.114)  # Rec. 601
_SIGMA = 0.7  # pixels
# Shares of the steepest slope in the image: all pixels of an edge are above the first, one of them
# above the second. As MATLAB's `edge(image, "canny", 0.15)`, which Bas et al. call.
_WEAK, _STRONG = 0.06, 0.15
_FAINTEST = 2.0  # grey levels a pixel; a plain surface with a camera's noise has less
_STEP = 8.0  # mm, by which what is seen next to an occluding edge lies behind it
_FINEST_CELL = 3.0  # mm


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

    The one of scikit-image does not tell in which direction an edge runs. The image is `(H, W, 3)`
    RGB, 0 to 255; one without any contrast has no edges.
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
    places = edges.points * n + low
    sides = ConvexHull(points).equations
    near = (places @ sides[:, :2].T + sides[:, 2]).max(1) < margin
    return ImageEdges(places[near], edges.normals[near])


class EdgeMatcher:
    """Finds the nearest of an image's edges that runs in much the same direction.

    Args:
        reach: Distance beyond which nothing matches, in units of the edges' points, `turn`
            included.
        turn: Distance that half a right angle between directions counts as, over the square root
            of 2. Which side is bright does not count.
    """

    def __init__(self, edges: ImageEdges, reach: float, turn: float):
        self._points, self._reach, self._turn = edges.points, reach, turn
        self._tree = KDTree(self._with_direction(edges.points, edges.normals))

    def match(self, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Edges for the points `(n, 2)` of a line, across which unit vectors are `(n, 2)`.

        Returns:
            `(m,)` int, those of the points for which there is an edge, and `(m, 2)` where it is.
        """
        line = self._with_direction(points, normals)
        distances, nearest = self._tree.query(line, distance_upper_bound=self._reach)
        near = np.flatnonzero(np.isfinite(distances))
        return near, self._points[nearest[near]]

    def _with_direction(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        x, y = normals.T
        of_twice_the_angle = np.stack([x * x - y * y, 2 * x * y], axis=1)
        return np.concatenate([points, self._turn * of_twice_the_angle], axis=1)


@dataclass(frozen=True, eq=False)
class OccludingEdges:
    """Mesh edges behind which a surface turns away from the viewer.

    Attributes:
        points: `(m, 3)` their middles, millimetres, frame of the model.
        basis: `(K, m, 3)` what one standard deviation of each coefficient adds to these.
        normals: `(m, 2)` unit vectors across them in the image, away from the surface, y up.
        shares: `(m,)` of the length of them all in the image.
    """

    points: np.ndarray
    basis: np.ndarray
    normals: np.ndarray
    shares: np.ndarray

    def __getitem__(self, rows: np.ndarray) -> OccludingEdges:
        return OccludingEdges(
            self.points[rows], self.basis[:, rows], self.normals[rows], self.shares[rows]
        )


class Surface:
    """A morphable model that is seen again and again, in other shapes and from elsewhere.

    Args:
        within: `(V,)` bool, the vertices whose edges are wanted; the others only hide them.
        n_identity: Number of leading identity components in the shapes.
    """

    def __init__(self, model: MorphableModel, within: np.ndarray, n_identity: int):
        edges = np.sort(model.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        order = np.lexsort(edges.T)
        edges, sides = edges[order], order // 3
        # The rim of the mesh, which has a triangle on one side only, is no edge of the surface.
        twins = np.flatnonzero((edges[1:] == edges[:-1]).all(1) & within[edges[1:]].all(1))
        self._triangles = model.triangles
        self._edges = edges[twins]
        self._sides = np.stack([sides[twins], sides[twins + 1]], axis=1)
        lengths = np.linalg.norm(model.mean[edges[:, 0]] - model.mean[edges[:, 1]], axis=1)
        self._cell = max(float(lengths.mean()), _FINEST_CELL)
        # Half the numbers are twice as fast, and their rounding is a thousandth of a millimetre.
        self._mean = model.mean.astype(np.float32)
        self._basis = model.identity_basis_times_sd[:n_identity].astype(np.float32, order="C")

    def occluding_edges(self, identity: np.ndarray, rotation: np.ndarray) -> OccludingEdges:
        """Those that are seen, and against nothing or something well behind them.

        Creases, and what is hidden by the surface itself, are left out: an image seldom has an
        edge there.

        Args:
            identity: `(n_identity,)` standard-normal coefficients.
            rotation: `(3, 3)`, to be multiplied from the left, to +x to the right of the image, +y
                up and +z towards the viewer, who is far.
        """
        shape = self._mean + np.tensordot(np.float32(identity), self._basis, 1)
        posed = shape @ np.float32(rotation.T)
        a, b, c = (posed[corner] for corner in self._triangles.T)
        (ux, uy, _), (vx, vy, _) = (b - a).T, (c - a).T
        facing = ux * vy > uy * vx
        front = facing[self._sides]
        turning = np.flatnonzero(front[:, 0] != front[:, 1])
        edges, sides = self._edges[turning], self._sides[turning]
        facing_side = np.where(front[turning, 0], sides[:, 0], sides[:, 1])
        x, y = (posed[edges[:, 1]] - posed[edges[:, 0]])[:, :2].T
        lengths = np.hypot(x, y)
        normals = np.stack([-y, x], axis=1) / np.maximum(lengths, 1e-9)[:, None]
        middles, centres = posed[edges].mean(1), (a + b + c) / 3
        inwards = ((centres[facing_side] - middles)[:, :2] * normals).sum(1) > 0
        normals[inwards] *= -1
        # Depth of the nearest point in each cell of the plane, -inf where there is none.
        points = np.concatenate([posed, centres[facing]])
        low = points[:, :2].min(0) - 3 * self._cell
        cells = np.int64((points[:, :2] - low) / self._cell)
        depth = np.full(cells.max(0) + 4, -np.inf, np.float32)
        np.maximum.at(depth, tuple(cells.T), points[:, 2])
        outside = np.int64((middles[:, :2] + 2 * self._cell * normals - low) / self._cell)
        seen = depth[tuple(outside.T)] < middles[:, 2] - _STEP
        edges, lengths = edges[seen], lengths[seen]
        return OccludingEdges(
            points=shape[edges].mean(1, dtype=float),
            basis=self._basis[:, edges].mean(2, dtype=float),
            normals=normals[seen].astype(float),
            shares=lengths.astype(float) / lengths.sum(),
        )
