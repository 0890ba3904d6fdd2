"""Where the landmarks of each scheme are on the face models: tables of vertices."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from deepmds_keras.files import read_table

# Of each scheme the table, and the number of its first landmark there.
_TABLES = {"bfm72": ("bfm72", 1), "ibug68": ("ibug68", 1), "ibug51": ("ibug68", 18)}
SCHEMES = tuple(_TABLES)
_FOLDER = Path(__file__).parent


@dataclass(frozen=True, eq=False)
class LandmarkVertices:
    """Vertex numbers of an ordered set of L landmarks, which are counted from 0.

    Attributes:
        numbers: `L` landmark numbers as the authors of the scheme count them, from 1.
        vertices: Face model name to `(L,)` 0-based vertex numbers (`ict`: original numbering);
            models on which every landmark is known.
        anchors: Face model name to `{landmark: vertex}`; also the partly known models.
    """

    numbers: tuple[int, ...]
    vertices: dict[str, np.ndarray]
    anchors: dict[str, dict[int, int]]


@cache
def load_vertices(scheme: str) -> LandmarkVertices:
    """Reads the table of a scheme.

    `"bfm72"` are the paper's 72 landmarks, `"ibug68"` those of Multi-PIE and iBUG 300-W, `"ibug51"`
    the latter without the jaw line. Their order, names and lines are in `deepmds_keras.landmarks`.
    """
    table, first = _TABLES[scheme]
    rows = [row for row in read_table(_FOLDER / f"{table}.csv") if int(row["number"]) >= first]
    anchors = {
        model: {i: int(row[model]) for i, row in enumerate(rows) if row[model]}
        for model in rows[0]
        if model != "number"
    }
    vertices = {
        model: np.array([*known.values()])
        for model, known in anchors.items()
        if len(known) == len(rows)
    }
    for known in vertices.values():
        known.flags.writeable = False  # the cached tables are shared by all callers
    return LandmarkVertices(tuple(int(row["number"]) for row in rows), vertices, anchors)


def known_landmarks(model: str, vertex_numbers: np.ndarray) -> dict[str, np.ndarray]:
    """Landmark vertices from the tables, as rows of a mesh that may hold only part of the model.

    Args:
        model: Column of the tables, such as `"ict"`.
        vertex_numbers: `(V,)` ascending, number of each mesh vertex in the whole model.

    Returns:
        Scheme name to `(L,)` mesh vertices; only schemes of which the mesh has every vertex.
    """
    tables = {scheme: load_vertices(scheme).vertices.get(model) for scheme in SCHEMES}
    return {
        scheme: np.searchsorted(vertex_numbers, vertices)
        for scheme, vertices in tables.items()
        if vertices is not None and np.isin(vertices, vertex_numbers).all()
    }


@cache
def load_basel_anchors() -> dict[str, dict[str, int]]:
    """Landmark names of the Basel Face Model 2017 and 2019 files to `{face model: vertex}`."""
    rows = read_table(_FOLDER / "basel_anchors.csv")
    return {row.pop("name"): {model: int(v) for model, v in row.items() if v} for row in rows}
