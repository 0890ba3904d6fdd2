"""Landmarks of one scheme in the order of another, where the two have the same points."""

from __future__ import annotations

from functools import cache
from itertools import groupby

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.landmarks import load_scheme, load_schemes

MISSING = ("raise", "nan")


def convert(
    landmarks: np.ndarray, source: str, target: str, *, missing: str = "raise"
) -> np.ndarray:
    """Landmarks in the order of another scheme.

    Points are picked, never moved: coordinates, unit and axes stay those of the source. Points that
    two schemes share are those of `ibug68` that both have, see `LandmarkScheme.ibug68`.

    Args:
        landmarks: `(n, L, d)` or `(L, d)`, `d` 2 or 3; `L` as `source` has it, or 478 points of
            MediaPipe, whose last ten, of the irises, are left out.
        source: Name of the scheme that the landmarks are in.
        target: Name of the scheme that they are wanted in.
        missing: What becomes of landmarks that the source lacks: `"raise"` refuses, `"nan"` gives
            NaN.

    Returns:
        `(n, M, d)` or `(M, d)` of floats, `M` as `target` has it.

    Raises:
        InputError: Unknown scheme or choice, landmarks of another shape, or the source lacks some
            and `missing` is `"raise"`.
    """
    schemes = load_schemes()
    for name, value, choices in (
        ("source", source, schemes),
        ("target", target, schemes),
        ("missing", missing, MISSING),
    ):
        if value not in choices:
            raise InputError(f"{name} must be one of {', '.join(choices)}. Received {value!r}.")
    landmarks = np.asarray(landmarks)
    sizes = schemes[source].sizes
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
    if landmarks.dtype.kind != "f":
        landmarks = landmarks.astype(float)
    picks = _picks(source, target)
    lacking = picks < 0
    if missing == "raise" and lacking.any():
        numbers = np.array(schemes[target].numbers)[lacking]
        raise InputError(
            f'{target} must have all its landmarks in {source}, or missing must be "nan". '
            f"Received landmarks without {lacking.sum()} of the {len(picks)}: {_ranges(numbers)}."
        )
    converted = landmarks[..., picks, :]
    converted[..., lacking, :] = np.nan
    return converted


def scheme_of(n_landmarks: int) -> str:
    """Return the name of the scheme that has so many landmarks, or takes so many.

    Raises:
        InputError: None has.
    """
    names = {size: name for name, scheme in load_schemes().items() for size in scheme.sizes}
    if n_landmarks not in names:
        *others, last = (f"{size} ({name})" for size, name in names.items())
        raise InputError(
            f"A face must have {', '.join(others)} or {last} landmarks. Received {n_landmarks}."
        )
    return names[n_landmarks]


def face_sizes() -> tuple[int, ...]:
    """Return the numbers of landmarks that a face may have, of any scheme, ascending."""
    return tuple(sorted({n for scheme in load_schemes().values() for n in scheme.sizes}))


def said_sizes() -> str:
    """Return those numbers as text."""
    *others, last = map(str, face_sizes())
    return f"{', '.join(others)} or {last}"


@cache
def _picks(source: str, target: str) -> np.ndarray:
    """`(M,)` positions in the source of the landmarks of the target, -1 where it has none."""
    found, wanted = load_scheme(source), load_scheme(target)
    if source == target:
        picks = np.arange(len(wanted))
    else:
        picks = np.full(len(wanted), -1)
        for number in found.ibug68.keys() & wanted.ibug68.keys():
            picks[wanted.ibug68[number]] = found.ibug68[number]
    picks.flags.writeable = False  # shared by all calls
    return picks


def _ranges(numbers: np.ndarray, most: int = 6) -> str:
    """Ascending numbers as text, runs of them as `first-last`, only the first few of many."""
    runs = [
        [number for _, number in run]
        for _, run in groupby(enumerate(numbers.tolist()), lambda item: item[1] - item[0])
    ]
    said = [str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs[:most]]
    return ", ".join(said + ["…"] * (len(runs) > most))
