"""Where the landmarks of each scheme are on the face models: vertex numbers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from deepmds_keras.errors import InputError
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
    """Reads the tables beside this file.

    Args:
        scheme: `"bfm72"`, the paper's 72 landmarks; `"ibug68"`, Multi-PIE / iBUG 300-W; `"ibug51"`,
            the latter without the jaw line. Their order, names and lines are in
            `deepmds_keras.landmarks`.

    Raises:
        InputError: Another name.
    """
    if scheme not in SCHEMES:
        raise InputError(
            f"landmark scheme must be one of {', '.join(SCHEMES)}. Received {scheme!r}."
        )
    table, first = _TABLES[scheme]
    rows = [row for row in _rows(f"{table}.csv") if int(row["number"]) >= first]
    models = [column for column in rows[0] if column != "number"]
    anchors = {
        model: {i: int(row[model]) for i, row in enumerate(rows) if row[model]} for model in models
    }
    vertices = {
        model: np.array([*known.values()])
        for model, known in anchors.items()
        if len(known) == len(rows)
    }
    for known in vertices.values():
        known.flags.writeable = False  # the cached tables are shared by all callers
    numbers = tuple(int(row["number"]) for row in rows)
    return LandmarkVertices(numbers, vertices, anchors)


@cache
def load_basel_anchors() -> dict[str, dict[str, int]]:
    """Landmark names of the Basel Face Model 2017 and 2019 files on other models.

    Returns:
        Name, as in `metadata/landmarks/json`, to `{face model: 0-based vertex number}`.
    """
    rows = _rows("basel_anchors.csv")
    return {row.pop("name"): {model: int(v) for model, v in row.items() if v} for row in rows}


def _rows(filename: str) -> list[dict[str, str]]:
    return read_table(_FOLDER / filename)
