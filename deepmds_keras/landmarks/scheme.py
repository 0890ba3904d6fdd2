"""A landmark scheme, and the tables that it is read from."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deepmds_keras.errors import InputError, brief
from deepmds_keras.files import read_table

_EYE_CORNERS = 37, 46  # in iBUG's 68


@dataclass(frozen=True, eq=False)
class LandmarkScheme:
    """An ordered set of L landmarks.

    Attributes:
        name: As in `schemes.csv`: `"bfm72"`, the paper's 72 landmarks; `"ibug68"`, Multi-PIE /
            iBUG 300-W (Sagonas et al. 2013, doi:10.1109/ICCVW.2013.59); `"ibug51"`, the latter
            without the jaw line; `"mediapipe"`, FaceMesh's 468 points. Of other
            objects the path of the table, or `"unnamed-14"` for any 14 landmarks.
        numbers: `L` landmark numbers as their authors count them (18 to 68 for `ibug51`).
            Everything below counts from 0 in this order instead.
        names: `L` unique anatomical names; right and left are the subject's. Points without one
            are `landmark_1`, after their number.
        groups: `L` names of facial parts, such as `right_brow` or `outer_mouth`, or `""`.
        mirror: `(L,)` int, the landmark at the mirrored place; its own inverse.
        polylines: Lines that draw the face, each a tuple of landmarks.
        ibug68: 1-based iBUG landmark number → the landmark at the same point; empty if the
            landmarks are not a face's.
        sizes: Accepted numbers of points: L, or more, of which the rest is dropped.
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
            InputError: No landmark has that name.
        """
        if name not in self.names:
            raise InputError(f"The scheme must have a landmark {name}. Received {self.name}.")
        return self.names.index(name)

    def eye_corners(self) -> tuple[int, int]:
        """Return the 0-based indices of the outer corners of the right and of the left eye.

        Raises:
            InputError: It lacks one.
        """
        right, left = map(self.ibug68.get, _EYE_CORNERS)
        if right is None or left is None:
            raise InputError(
                "The scheme must have the outer corners of both eyes, iBUG's landmarks "
                f"{_EYE_CORNERS[0]} and {_EYE_CORNERS[1]}. Received {self.name}."
            )
        return right, left

    @property
    def is_face(self) -> bool:
        """Whether the landmarks are a face's."""
        return bool(self.ibug68)

    @property
    def thing(self) -> str:
        """What the landmarks are of, for readers: a face, or any other shape."""
        return "face" if self.is_face else "shape"


def read_scheme(
    name: str, table: Path, numbers: range, *, longer: tuple[int, ...] = (), is_ibug: bool = False
) -> LandmarkScheme:
    """The scheme of some landmarks of a table.

    Args:
        table: File of the landmarks; see `schemes.csv` for those beside it. None need exist.
        longer: Other accepted numbers of points.
        is_ibug: Whether the table is that of iBUG's 68 itself.
    """
    position = {number: i for i, number in enumerate(numbers)}
    unnamed = [{"number": f"{number}", "name": f"landmark_{number}"} for number in numbers]
    landmarks = [each for each in _rows(table) or unnamed if int(each["number"]) in position]
    lines = [_line(each["landmarks"]) for each in _rows(table, "_polylines")]
    mirror = [position[int(each.get("mirror") or each["number"])] for each in landmarks]
    same = {int(each["ibug68"]): position[int(each["number"])] for each in _rows(table, "_ibug68")}
    return LandmarkScheme(
        name=name,
        numbers=tuple(numbers),
        names=tuple(each["name"] for each in landmarks),
        groups=tuple(each.get("group") or "" for each in landmarks),
        mirror=_shared(np.array(mirror, int)),
        polylines=tuple(
            tuple(position[number] for number in line)
            for line in lines
            if position.keys() >= set(line)
        ),
        ibug68=position if is_ibug else same,
        sizes=(len(numbers), *longer),
    )


def read_own_scheme(path: Path) -> LandmarkScheme:
    """The scheme of a user's table, with columns number, name and perhaps mirror and group.

    Raises:
        InputError: It cannot be read; numbers do not count up, a name is missing or given twice,
            mirrored landmarks are not each other's, or a line has a landmark that the table lacks.
    """
    rows = read_table(path)
    try:
        numbers = [int(row["number"]) for row in rows]
        names = [row["name"] for row in rows]
        mirrors = {int(row["number"]): int(row.get("mirror") or row["number"]) for row in rows}
        lines = [_line(row["landmarks"]) for row in _rows(path, "_polylines")]
        same = [(int(row["number"]), int(row["ibug68"])) for row in _rows(path, "_ibug68")]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path} must have the columns number and name, optionally mirror and group, its table "
            "of polylines the column landmarks, with values such as 1-2-3, and that of iBUG's "
            "landmarks the columns number and ibug68. "
            f"Received {type(error).__name__}: {brief(error)}."
        ) from None
    if not rows or numbers != [*range(numbers[0], numbers[0] + len(rows))]:
        raise InputError(
            f"{path} must have landmarks with consecutive numbers. Received {brief(numbers, 40)}."
        )
    earlier: set[str] = set()
    for number, name in zip(numbers, names, strict=True):
        if not name or name in earlier:
            raise InputError(
                f"{path} must give each landmark a different name. "
                f"Received {f'{name} again' if name else 'none'} for landmark {number}."
            )
        earlier.add(name)
    for number, mirror in mirrors.items():
        if mirrors.get(mirror) != number:
            raise InputError(
                f"{path} must pair landmarks in the column mirror, each with the other. "
                f"Received {mirror} for landmark {number}, and {mirrors.get(mirror)} for {mirror}."
            )
    unknown = {number for line in lines for number in line} - {*numbers}
    if unknown:
        raise InputError(
            f"{_beside(path, '_polylines')} must join landmarks of {path}. "
            f"Received {min(unknown)}, which it lacks."
        )
    for column, values, known in (
        ("number", [number for number, _ in same], numbers),
        ("ibug68", [number for _, number in same], range(1, 69)),
    ):
        if len({*values}) < len(values) or not {*values} <= {*known}:
            raise InputError(
                f"{_beside(path, '_ibug68')} must have a different {column} in each row, from "
                f"{known[0]} to {known[-1]}. Received {brief(values, 40)}."
            )
    return read_scheme(str(path), path, range(numbers[0], numbers[-1] + 1))


def scheme_files(table: Path) -> list[Path]:
    """Files of a user's scheme, of which only the table itself must exist."""
    return [_beside(table, kind) for kind in ("", "_polylines", "_ibug68")]


def versions(table: Path) -> tuple[tuple[int, int] | None, ...]:
    """When the files of a scheme were written, and their sizes."""
    states = [path.stat() if path.is_file() else None for path in scheme_files(table)]
    return tuple(state and (state.st_mtime_ns, state.st_size) for state in states)


def _rows(table: Path, kind: str = "") -> list[dict[str, str]]:
    path = _beside(table, kind)
    return read_table(path) if path.is_file() else []


def _beside(table: Path, kind: str) -> Path:
    return table.with_name(f"{table.stem}{kind}.csv") if kind else table


def _line(text: str | None) -> tuple[int, ...]:
    return tuple(map(int, (text or "").split("-")))  # None where a row has too few cells


def _shared(array: np.ndarray) -> np.ndarray:
    """Read-only: the cached scheme is shared by all callers."""
    array.flags.writeable = False
    return array
