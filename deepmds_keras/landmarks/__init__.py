"""Landmark schemes: order, names, mirror pairs, drawing lines, and conversion."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from deepmds_keras.errors import InputError, brief
from deepmds_keras.files import read_table
from deepmds_keras.validation import as_numbers

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
        mirror: `(L,)` int, the landmark at the mirrored place; its own inverse.
        polylines: Lines that draw the face, each a tuple of landmarks.
        ibug68: 1-based iBUG landmark number → the landmark at the same point.
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


@cache
def load_schemes() -> dict[str, LandmarkScheme]:
    """Return every scheme by its name, in the order of `schemes.csv`."""
    return {row["scheme"]: _read_scheme(row) for row in read_table(FOLDER / "schemes.csv")}


def load_scheme(name: str) -> LandmarkScheme:
    """Return the scheme of that name.

    Raises:
        InputError: Unknown name.
    """
    schemes = load_schemes()
    if name not in schemes:
        raise InputError(f"scheme must be one of {', '.join(schemes)}. Received {name!r}.")
    return schemes[name]


def convert(
    landmarks: np.ndarray, source: str, target: str, *, missing: str = "raise"
) -> np.ndarray:
    """Landmarks in the order of another scheme.

    Points are selected, never moved: coordinates, unit and axes stay those of the source. Two
    schemes share the points of `ibug68` that both have, see `LandmarkScheme.ibug68`.

    Args:
        landmarks: `(n, L, d)` or `(L, d)`, `d` 2 or 3; `L` as in `source`, or MediaPipe's 478
            points, whose last ten, of the irises, are dropped.
        source: Name of the scheme of the landmarks.
        target: Name of the scheme to convert to.
        missing: What to do about landmarks that the source lacks: `"raise"` an error, or fill in
            `"nan"`.

    Returns:
        `(n, M, d)` or `(M, d)` floats, `M` as in `target`; NaN where the input is masked.

    Raises:
        InputError: Unknown scheme or choice, landmarks of another shape, or the source lacks some
            and `missing` is `"raise"`.
    """
    if missing not in ("raise", "nan"):
        raise InputError(f"missing must be raise or nan. Received {missing!r}.")
    picks, sizes = _picks(source, target), load_scheme(source).sizes
    is_masked = np.ma.isMaskedArray(landmarks)
    landmarks = as_numbers(landmarks, "landmarks") if is_masked else np.asarray(landmarks)
    if not (
        landmarks.ndim in (2, 3)
        and landmarks.shape[-2] in sizes
        and landmarks.shape[-1] in (2, 3)
        and landmarks.dtype.kind in "fiu"
    ):
        raise InputError(
            f"landmarks of {source} must be numbers of shape (n, L, d) or (L, d), L = "
            f"{' or '.join(map(str, sizes))}, d = 2 or 3. "
            f"Received {landmarks.shape} of {landmarks.dtype}."
        )
    lacking = picks < 0
    if missing == "raise" and lacking.any():
        numbers = np.array(load_scheme(target).numbers)[lacking].tolist()
        raise InputError(
            f'{target} must have all its landmarks in {source}, or missing must be "nan". Received '
            f"landmarks without {len(numbers)} of the {len(picks)}: {brief(numbers, 40)}."
        )
    kept = landmarks if landmarks.dtype.kind == "f" else landmarks.astype(float)
    converted = kept[..., picks, :]
    converted[..., lacking, :] = np.nan
    return converted


def scheme_of(n_landmarks: int) -> str:
    """Return the name of the scheme with that number of landmarks.

    Raises:
        InputError: There is none.
    """
    for name, scheme in load_schemes().items():
        if n_landmarks in scheme.sizes:
            return name
    raise InputError(f"A face must have {said_sizes()} landmarks. Received {n_landmarks}.")


def face_sizes() -> tuple[int, ...]:
    """Return the numbers of landmarks of all schemes, in ascending order."""
    return tuple(sorted({n for scheme in load_schemes().values() for n in scheme.sizes}))


def said_sizes() -> str:
    """Return those numbers as text."""
    *others, last = map(str, face_sizes())
    return f"{', '.join(others)} or {last}"


def _read_scheme(row: dict[str, str]) -> LandmarkScheme:
    numbers = range(int(row["first"]), int(row["last"]) + 1)
    position = {number: i for i, number in enumerate(numbers)}
    landmarks = [each for each in _rows(row, "") if int(each["number"]) in position]
    lines = [tuple(map(int, each["landmarks"].split("-"))) for each in _rows(row, "_polylines")]
    mirror = np.array([position[int(each["mirror"])] for each in landmarks], int)
    mirror.flags.writeable = False  # the cached scheme is shared by all callers
    same = {int(each["ibug68"]): position[int(each["number"])] for each in _rows(row, "_ibug68")}
    return LandmarkScheme(
        name=row["scheme"],
        numbers=tuple(numbers),
        names=tuple(each["name"] for each in landmarks),
        groups=tuple(each["group"] for each in landmarks),
        mirror=mirror,
        polylines=tuple(
            tuple(position[number] for number in line)
            for line in lines
            if position.keys() >= set(line)
        ),
        ibug68=position if row["table"] == "ibug68" else same,
        sizes=(len(numbers), *([int(row["longer"])] if row["longer"] else [])),
    )


def _rows(row: dict[str, str], kind: str) -> list[dict[str, str]]:
    path = FOLDER / f"{row['table']}{kind}.csv"
    return read_table(path) if path.is_file() else []


@cache
def _picks(source: str, target: str) -> np.ndarray:
    """`(M,)` positions in the source of the landmarks of the target, -1 where it has none."""
    given, wanted = load_scheme(source), load_scheme(target)
    if source == target:
        picks = np.arange(len(wanted))
    else:
        picks = np.full(len(wanted), -1)
        for number in given.ibug68.keys() & wanted.ibug68.keys():
            picks[wanted.ibug68[number]] = given.ibug68[number]
    picks.flags.writeable = False  # shared by all calls
    return picks
