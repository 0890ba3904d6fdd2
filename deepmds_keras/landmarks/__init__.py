"""Landmark schemes: order, names, mirror pairs, drawing lines, and conversion."""

import re
from collections.abc import Collection
from functools import cache, lru_cache
from pathlib import Path

import numpy as np

from deepmds_keras.errors import InputError, brief, check_choice
from deepmds_keras.files import read_table
from deepmds_keras.landmarks.scheme import (
    LandmarkScheme,
    read_own_scheme,
    read_scheme,
    versions,
)
from deepmds_keras.validation import as_numbers

FOLDER = Path(__file__).parent
DETECTOR_ERRORS = FOLDER / "detectors.csv"
_UNNAMED = "unnamed-"


@cache
def load_schemes() -> dict[str, LandmarkScheme]:
    """Return every shipped scheme by its name, in the order of `schemes.csv`."""
    return {
        row["scheme"]: read_scheme(
            row["scheme"],
            FOLDER / f"{row['table']}.csv",
            range(int(row["first"]), int(row["last"]) + 1),
            longer=(int(row["longer"]),) if row["longer"] else (),
            is_ibug=row["table"] == "ibug68",
        )
        for row in read_table(FOLDER / "schemes.csv")
    }


def load_scheme(name: str | Path) -> LandmarkScheme:
    """Return the scheme of that name.

    Args:
        name: One of `load_schemes`; the path of a table of your own, `chair.csv`, with the columns
            number, name and, optionally, mirror and group, and beside it `chair_polylines.csv`; or
            `"unnamed-14"`, which is any 14 landmarks.

    Raises:
        InputError: Unknown name, or a table that cannot be read or contradicts itself.
    """
    schemes, name = load_schemes(), str(name)
    if name.lower().endswith(".csv"):
        return _own_scheme(Path(name), versions(Path(name)))
    if match := re.fullmatch(rf"{_UNNAMED}([1-9]\d{{0,3}})", name):
        return _unnamed(name, int(match[1]))
    if name not in schemes:
        raise InputError(
            f"scheme must be one of {', '.join(schemes)}, or your own table (CSV). "
            f"Received {name!r}."
        )
    return schemes[name]


def unnamed(n_landmarks: int) -> str:
    """Return the name of the scheme of any landmarks of that number."""
    return f"{_UNNAMED}{n_landmarks}"


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
    check_choice(missing, "missing", ("raise", "nan"))
    given, wanted = load_scheme(source), load_scheme(target)
    picks, sizes = _picks(given, wanted), given.sizes
    if np.ma.isMaskedArray(landmarks) or not isinstance(landmarks, np.ndarray):
        landmarks = as_numbers(landmarks, "landmarks")
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
        numbers = np.array(wanted.numbers)[lacking].tolist()
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


def said_sizes(sizes: Collection[int] | None = None) -> str:
    """Return numbers of landmarks as text, by default those of all schemes."""
    *others, last = map(str, sizes or face_sizes())
    return f"{', '.join(others)} or {last}" if others else last


_own_scheme = lru_cache(lambda path, _: read_own_scheme(path))
_unnamed = cache(lambda name, n: read_scheme(name, FOLDER / name, range(1, n + 1)))


@lru_cache
def _picks(given: LandmarkScheme, wanted: LandmarkScheme) -> np.ndarray:
    """`(M,)` positions in the source of the landmarks of the target, -1 where it has none."""
    if given.name == wanted.name:
        picks = np.arange(len(wanted))
    else:
        picks = np.full(len(wanted), -1)
        for number in given.ibug68.keys() & wanted.ibug68.keys():
            picks[wanted.ibug68[number]] = given.ibug68[number]
    picks.flags.writeable = False  # shared by all calls
    return picks
