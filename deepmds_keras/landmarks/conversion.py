"""Landmarks of one scheme in the order of another, where the two have the same points."""

from __future__ import annotations

from functools import cache
from itertools import groupby

import numpy as np

from deepmds_keras.io.errors import InputError
from deepmds_keras.io.tables import read_table
from deepmds_keras.landmarks import FOLDER, load_scheme

SIZES = {"bfm72": 72, "ibug68": 68, "ibug51": 51, "mediapipe": 468}
SCHEMES = tuple(SIZES)
WITH_IRISES = 478  # points of FaceMesh when it refines the eyes: the 468, then ten of the irises
MISSING = ("raise", "nan")


def convert(
    landmarks: np.ndarray, source: str, target: str, *, missing: str = "raise"
) -> np.ndarray:
    """Landmarks in the order of another scheme.

    Points are picked, never moved: coordinates, unit and axes stay those of the source. Points that
    two schemes share are those of `ibug68` that both have: of `ibug51` its number, of `mediapipe`
    the list in `mediapipe51.csv` (column `corrected`), of `bfm72` the pairs in `bfm72_ibug68.csv`.

    Args:
        landmarks: `(n, L, d)` or `(L, d)`, `d` 2 or 3; `L` as `source` has it, or 478 points of
            MediaPipe, whose last ten are left out.
        source: One of `SCHEMES`, which the landmarks are in.
        target: One of `SCHEMES`, which they are wanted in.
        missing: What becomes of landmarks that the source lacks: `"raise"` refuses, `"nan"` gives
            NaN.

    Returns:
        `(n, M, d)` or `(M, d)` of floats, `M` as `target` has it.

    Raises:
        InputError: Unknown scheme or choice, landmarks of another shape, or the source lacks some
            and `missing` is `"raise"`.
    """
    for name, value, choices in (
        ("source", source, SCHEMES),
        ("target", target, SCHEMES),
        ("missing", missing, MISSING),
    ):
        if value not in choices:
            raise InputError(f"{name} must be one of {', '.join(choices)}. Received {value!r}.")
    landmarks = np.asarray(landmarks)
    sizes = (SIZES[source], WITH_IRISES) if source == "mediapipe" else (SIZES[source],)
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
        numbers = np.array(_numbers(target))[lacking]
        raise InputError(
            f'{target} must have all its landmarks in {source}, or missing must be "nan". '
            f"Received landmarks without {lacking.sum()} of the {len(picks)}: {_ranges(numbers)}."
        )
    converted = landmarks[..., picks, :]
    converted[..., lacking, :] = np.nan
    return converted


def scheme_of(n_landmarks: int) -> str:
    """The scheme that has so many landmarks: 51, 68, 72, or MediaPipe's 468 or 478.

    Raises:
        InputError: No scheme has.
    """
    for name, size in SIZES.items():
        if n_landmarks == size:
            return name
    if n_landmarks == WITH_IRISES:
        return "mediapipe"
    choices = ", ".join(f"{size} ({name})" for name, size in SIZES.items())
    raise InputError(
        f"A face must have {choices} or {WITH_IRISES} (mediapipe with irises) landmarks. "
        f"Received {n_landmarks}."
    )


@cache
def _picks(source: str, target: str) -> np.ndarray:
    """`(M,)` positions in the source of the landmarks of the target, -1 where it has none."""
    if source == target:
        picks = np.arange(SIZES[target])
    else:
        found, wanted = _ibug_positions(source), _ibug_positions(target)
        picks = np.full(SIZES[target], -1)
        for number in found.keys() & wanted.keys():
            picks[wanted[number]] = found[number]
    picks.flags.writeable = False  # shared by all calls
    return picks


def _ibug_positions(name: str) -> dict[int, int]:
    """iBUG landmark number, 1-based, to the 0-based position of that point in a scheme."""
    if name == "bfm72":
        rows = read_table(FOLDER / "bfm72_ibug68.csv")
        return {int(row["ibug68"]): int(row["bfm72"]) - 1 for row in rows}
    if name == "mediapipe":
        rows = read_table(FOLDER / "mediapipe51.csv")
        return {int(row["number"]): int(row["corrected"]) for row in rows}
    return {number: i for i, number in enumerate(load_scheme(name).numbers)}


def _numbers(name: str) -> tuple[int, ...]:
    """Landmark numbers as the authors of a scheme count them: MediaPipe's from 0."""
    return tuple(range(SIZES[name])) if name == "mediapipe" else load_scheme(name).numbers


def _ranges(numbers: np.ndarray, most: int = 6) -> str:
    """Ascending numbers as text, runs of them as `first-last`, only the first few of many."""
    runs = [
        [number for _, number in run]
        for _, run in groupby(enumerate(numbers.tolist()), lambda item: item[1] - item[0])
    ]
    said = [str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs[:most]]
    return ", ".join(said + ["…"] * (len(runs) > most))
