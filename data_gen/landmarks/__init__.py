"""Landmark schemes: names, mirror pairs, drawing lines, and vertex numbers on each face model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from data_gen.errors import DataError
from data_gen.tables import read_table

SCHEMES = ("bfm72", "ibug68", "ibug51")
_FOLDER = Path(__file__).parent
_DESCRIPTION = ("number", "name", "group", "mirror")


@dataclass(frozen=True, eq=False)
class LandmarkScheme:
    """An ordered set of L landmarks.

    Attributes:
        name: One of `SCHEMES`.
        numbers: `L` landmark numbers as their authors count them, 1-based (18 to 68 for `ibug51`).
            Everything below counts from 0 in this order instead.
        names: `L` unique anatomical names; right and left are the subject's.
        groups: `L` names of facial parts, such as `right_brow` or `outer_mouth`.
        mirror: `(L,)` int, the landmark that the other half of the face has; its own inverse.
        polylines: Lines that draw the face, each a tuple of landmarks.
        vertices: Face model name to `(L,)` 0-based vertex numbers (`ict`: original numbering);
            models on which every landmark is known.
        anchors: Face model name to `{landmark: vertex}`; also the partly known models.
    """

    name: str
    numbers: tuple[int, ...]
    names: tuple[str, ...]
    groups: tuple[str, ...]
    mirror: np.ndarray
    polylines: tuple[tuple[int, ...], ...]
    vertices: dict[str, np.ndarray]
    anchors: dict[str, dict[int, int]]

    def __len__(self) -> int:
        return len(self.numbers)


@cache
def load_scheme(name: str) -> LandmarkScheme:
    """Reads the landmark tables beside this file.

    Args:
        name: `"bfm72"`, the paper's 72 landmarks; `"ibug68"`, Multi-PIE / iBUG 300-W
            (Sagonas et al. 2013, doi:10.1109/ICCVW.2013.59); `"ibug51"`, the latter without the
            jaw line.

    Raises:
        DataError: Another name.
    """
    if name == "bfm72":
        return _read_scheme(name, _rows("bfm72.csv"), _rows("bfm72_polylines.csv"))
    if name in ("ibug68", "ibug51"):
        rows = _rows("ibug68.csv")
        inner = rows if name == "ibug68" else rows[17:]
        return _read_scheme(name, inner, _rows("ibug68_polylines.csv"))
    raise DataError(f"landmark scheme must be one of {', '.join(SCHEMES)}. Received {name!r}.")


@cache
def load_basel_anchors() -> dict[str, dict[str, int]]:
    """Landmark names of the Basel Face Model 2017 and 2019 files on other models.

    Returns:
        Name, as in `metadata/landmarks/json`, to `{face model: 0-based vertex number}`.
    """
    rows = _rows("basel_anchors.csv")
    return {row.pop("name"): {model: int(v) for model, v in row.items() if v} for row in rows}


def _rows(filename: str) -> list[dict[str, str]]:
    return read_table(_FOLDER / filename)[1]


def _read_scheme(
    name: str, rows: list[dict[str, str]], polyline_rows: list[dict[str, str]]
) -> LandmarkScheme:
    position = {int(row["number"]): i for i, row in enumerate(rows)}
    models = [column for column in rows[0] if column not in _DESCRIPTION]
    anchors = {
        model: {i: int(row[model]) for i, row in enumerate(rows) if row[model]} for model in models
    }
    polylines = [tuple(map(int, row["landmarks"].split("-"))) for row in polyline_rows]
    return LandmarkScheme(
        name=name,
        numbers=tuple(position),
        names=tuple(row["name"] for row in rows),
        groups=tuple(row["group"] for row in rows),
        mirror=_frozen([position[int(row["mirror"])] for row in rows]),
        polylines=tuple(
            tuple(position[number] for number in line)
            for line in polylines
            if position.keys() >= set(line)
        ),
        vertices={
            model: _frozen(list(known.values()))
            for model, known in anchors.items()
            if len(known) == len(rows)
        },
        anchors=anchors,
    )


def _frozen(numbers: list[int]) -> np.ndarray:
    array = np.array(numbers, dtype=int)
    array.flags.writeable = False  # the cached scheme is shared by all callers
    return array
