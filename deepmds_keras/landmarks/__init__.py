"""Landmark schemes: order, names, mirror pairs and drawing lines."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from deepmds_keras.io.errors import InputError
from deepmds_keras.io.tables import read_table

SCHEMES = ("bfm72", "ibug68", "ibug51")
FOLDER = Path(__file__).parent


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
    """

    name: str
    numbers: tuple[int, ...]
    names: tuple[str, ...]
    groups: tuple[str, ...]
    mirror: np.ndarray
    polylines: tuple[tuple[int, ...], ...]

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
        InputError: Another name.
    """
    if name not in SCHEMES:
        raise InputError(f"scheme must be one of {', '.join(SCHEMES)}. Received {name!r}.")
    table = "bfm72" if name == "bfm72" else "ibug68"
    rows = read_table(FOLDER / f"{table}.csv")
    rows = rows[17:] if name == "ibug51" else rows
    position = {int(row["number"]): i for i, row in enumerate(rows)}
    polylines = [
        tuple(map(int, row["landmarks"].split("-")))
        for row in read_table(FOLDER / f"{table}_polylines.csv")
    ]
    mirror = np.array([position[int(row["mirror"])] for row in rows])
    mirror.flags.writeable = False  # the cached scheme is shared by all callers
    return LandmarkScheme(
        name=name,
        numbers=tuple(position),
        names=tuple(row["name"] for row in rows),
        groups=tuple(row["group"] for row in rows),
        mirror=mirror,
        polylines=tuple(
            tuple(position[number] for number in line)
            for line in polylines
            if position.keys() >= set(line)
        ),
    )
