"""Edges of a face model that should be found among those of an image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_gen.models.morphable_model import MorphableModel

_STEP = 8.0  # mm, by which what is seen beside an occluding edge lies behind it
_FINEST_CELL = 3.0  # mm


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
        model: Morphable model.
        within: `(V,)` bool, the vertices whose edges are wanted; the others only hide them.
        n_identity: How many of the first identity components shapes have.
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
        beside = np.int64((middles[:, :2] + 2 * self._cell * normals - low) / self._cell)
        seen = depth[tuple(beside.T)] < middles[:, 2] - _STEP
        edges, lengths = edges[seen], lengths[seen]
        return OccludingEdges(
            points=shape[edges].mean(1, dtype=float),
            basis=self._basis[:, edges].mean(2, dtype=float),
            normals=normals[seen].astype(float),
            shares=lengths.astype(float) / lengths.sum(),
        )
