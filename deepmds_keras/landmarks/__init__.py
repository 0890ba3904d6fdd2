"""Landmark schemes: order, names, mirror pairs, drawing lines, and points that they share."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.files import read_table

FOLDER = Path(__file__).parent


@dataclass(frozen=True, eq=False)
class LandmarkScheme:
    """An ordered set of L landmarks.

    Attributes:
        name: As in `schemes.csv`: `"bfm72"`, the paper's 72 landmarks; `"ibug68"`, Multi-PIE /
            iBUG 300-W (Sagonas et al. 2013, doi:10.1109/ICCVW.2013.59); `"ibug51"`, the latter
            without the jaw line; `"mediapipe"`, FaceMesh's 468 points, which have no names.
        numbers: `L` landmark numbers as their authors count them (18 to 68 for `ibug51`).
            Everything below counts from 0 in this order instead.
        names: `L` unique anatomical names, or none; right and left are the subject's.
        groups: `L` names of facial parts, such as `right_brow` or `outer_mouth`, or none.
        mirror: `(L,)` int, the landmark that the other half of the face has; its own inverse.
        polylines: Lines that draw the face, each a tuple of landmarks.
        ibug68: iBUG landmark number, 1-based, to the landmark that is the same point.
        sizes: How many points a face may have: L, or some more that are left out.
    """

    name: str
    numbers: tuple[int, ...]
    names: tuple[str, ...]
    groups: tuple[str, ...]
    mirror: np.ndarray
    polylines: tuple[tuple[int, ...], ...]
    ibug68: dict[int, int]
    sizes: tuple[int, ...]

    def __len__(self) -> int:
        return len(self.numbers)

    def index(self, name: str) -> int:
        """Return the 0-based index of a landmark.

        Raises:
            InputError: None has that name.
        """
        if name not in self.names:
            raise InputError(f"The scheme must have a landmark {name}. Received {self.name}.")
        return self.names.index(name)


@cache
def load_schemes() -> dict[str, LandmarkScheme]:
    """Return every scheme by its name, in the order of `schemes.csv`.

    Raises:
        InputError: The tables of a scheme cannot be read or do not fit together.
    """
    return {row["scheme"]: _read_scheme(row) for row in read_table(FOLDER / "schemes.csv")}


def load_scheme(name: str) -> LandmarkScheme:
    """Return the scheme of a name.

    Raises:
        InputError: There is none.
    """
    schemes = load_schemes()
    if name not in schemes:
        raise InputError(f"scheme must be one of {', '.join(schemes)}. Received {name!r}.")
    return schemes[name]


def _read_scheme(row: dict[str, str]) -> LandmarkScheme:
    try:
        numbers = range(int(row["first"]), int(row["last"]) + 1)
        position = {number: i for i, number in enumerate(numbers)}
        landmarks = [own for own in _rows(row, "") if int(own["number"]) in position]
        if landmarks and [int(own["number"]) for own in landmarks] != [*numbers]:
            raise ValueError(f"numbers other than {numbers[0]} to {numbers[-1]}")
        lines = [tuple(map(int, own["landmarks"].split("-"))) for own in _rows(row, "_polylines")]
        same = {int(own["ibug68"]): position[int(own["number"])] for own in _rows(row, "_ibug68")}
        mirror = np.array([position[int(own["mirror"])] for own in landmarks], int)
        mirror.flags.writeable = False  # the cached scheme is shared by all callers
        return LandmarkScheme(
            name=row["scheme"],
            numbers=tuple(numbers),
            names=tuple(own["name"] for own in landmarks),
            groups=tuple(own["group"] for own in landmarks),
            mirror=mirror,
            polylines=tuple(
                tuple(position[number] for number in line)
                for line in lines
                if position.keys() >= set(line)
            ),
            ibug68=position if row["table"] == "ibug68" else same,
            sizes=(len(numbers), *([int(row["longer"])] if row["longer"] else [])),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"The tables of the scheme {row.get('scheme')} in {FOLDER} must fit together, as "
            f"schemes.csv says. Received {type(error).__name__}: {error}."
        ) from None


def _rows(row: dict[str, str], kind: str) -> list[dict[str, str]]:
    path = FOLDER / f"{row['table']}{kind}.csv"
    return read_table(path) if path.is_file() else []
