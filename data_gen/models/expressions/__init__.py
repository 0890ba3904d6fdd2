"""Expressions as subjects perform them: the sequences of CoMA and the held faces of CASIA.

Neither data set is free to share. The open substitutes mix named blendshapes into key poses, listed
in the CSV tables of this folder, and move between those. Weights are 0 for neutral and 1 for the
full expression. Sequences: CoMA (Ranjan et al. 2018, doi:10.1007/978-3-030-01219-9_43).
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.errors import InputError
from deepmds_keras.files import read_table

_SIDES = {"left": ("Left",), "right": ("Right",), "both": ("Left", "Right"), "none": ("",)}
# What else moves a little in a performing face; each harmless with any pose.
_CO_ACTIVE = (
    *("browInnerUp", "browDownLeft", "browDownRight", "browOuterUpLeft", "browOuterUpRight"),
    *("eyeBlinkLeft", "eyeBlinkRight", "eyeSquintLeft", "eyeSquintRight"),
    *("cheekSquintLeft", "cheekSquintRight", "noseSneerLeft", "noseSneerRight"),
    *("jawForward", "jawLeft", "jawRight", "mouthLeft", "mouthRight"),
    *("mouthSmileLeft", "mouthSmileRight", "mouthFrownLeft", "mouthFrownRight"),
    *("mouthDimpleLeft", "mouthDimpleRight", "mouthStretchLeft", "mouthStretchRight"),
)
_N_CO_ACTIVE, _CO_ACTIVITY = 3, 0.2
_STRENGTH = (0.7, 1.1)
_PERFORMED_ASYMMETRY, _HELD_ASYMMETRY = 0.25, 0.1  # how far a side's factor is from 1 at most
# Mean time of each part of a performance in units of that of one movement, and its jitter.
_REST, _HOLD, _JITTER = 0.4, 0.7, 0.4


def _read(filename: str) -> dict[str, list[dict[str, float]]]:
    """Names to key poses, each the weights of named expressions."""
    poses: dict[str, dict[str, dict[str, float]]] = {}
    for row in read_table(Path(__file__).parent / filename):
        pose = poses.setdefault(row["name"], {}).setdefault(row["pose"], {})
        pose |= {row["expression"] + side: float(row["weight"]) for side in _SIDES[row["side"]]}
    return {name: list(keys.values()) for name, keys in poses.items()}


_PERFORMED, _HELD = _read("coma.csv"), _read("casia.csv")
SEQUENCES = tuple(_PERFORMED)
SCAN_EXPRESSIONS = tuple(_HELD)
# The same in the same order for every model, so that equal random numbers give equal expressions.
_NAMES = sorted(
    {name for poses in (*_PERFORMED.values(), *_HELD.values()) for pose in poses for name in pose}
    | set(_CO_ACTIVE)
)
# The lids have met by about 1 and would cross beyond.
_MAX_WEIGHT = np.array([1.0 if name.startswith("eyeBlink") else 1.2 for name in _NAMES])
_NUMBERS_CO_ACTIVE = np.array([_NAMES.index(name) for name in _CO_ACTIVE])
_IS_LEFT, _IS_RIGHT = (
    np.array([name.endswith(side) for name in _NAMES]) for side in ("Left", "Right")
)


def _vectors(poses: list[dict[str, float]]) -> np.ndarray:
    return np.array([[pose.get(name, 0.0) for name in _NAMES] for pose in poses])


# `(2 + poses, names)` each: neutral, the key poses, neutral.
_COURSES = [np.pad(_vectors(poses), ((1, 1), (0, 0))) for poses in _PERFORMED.values()]
_HELD_POSES = np.concatenate([_vectors(poses) for poses in _HELD.values()])


def sequence_weights(
    model: MorphableModel, sequence: str, n_frames: int, rng: np.random.Generator
) -> np.ndarray:
    """One performance of one of `SEQUENCES`: from neutral smoothly to each key pose, and back.

    Strength, timing, and how much more one side does than the other are random, and a few other
    expressions come and go a little.

    Returns:
        `(n_frames, E)` expression weights in [0, 1.2], evenly spaced in time; those of the first
        and last frame are 0.

    Raises:
        InputError: The names of the model's expressions are not known.
    """
    columns = _columns(model)
    course = np.repeat(_COURSES[SEQUENCES.index(sequence)], 2, axis=0)
    mean_spans = np.resize([_HOLD, 1.0], len(course) - 1)
    mean_spans[[0, -1]] = _REST
    spans = mean_spans * rng.uniform(1 - _JITTER, 1 + _JITTER, len(mean_spans))
    moments = np.concatenate([[0], spans.cumsum()]) / spans.sum()
    time = np.linspace(0, 1, n_frames)
    place = np.interp(time, moments, np.arange(len(moments)))
    before = np.minimum(place.astype(int), len(course) - 2)
    weights = _between(course[before], course[before + 1], place - before)
    weights *= _strengths(1, _PERFORMED_ASYMMETRY, rng)
    others = rng.choice(_NUMBERS_CO_ACTIVE, _N_CO_ACTIVE, replace=False)
    height = rng.uniform(0, _CO_ACTIVITY, _N_CO_ACTIVE)
    rate, phase = rng.uniform(0.5, 2, _N_CO_ACTIVE), rng.random(_N_CO_ACTIVE)
    waves = height * _ease(2 * (rate * time[:, None] + phase))
    weights[:, others] += waves * _ease(2 * time)[:, None]
    return weights.clip(0, _MAX_WEIGHT) @ columns


def scan_expression_weights(
    model: MorphableModel, names: Sequence[str], rng: np.random.Generator
) -> np.ndarray:
    """Held expressions, each of random strength and a little lopsided.

    Returns:
        `(n, E)` expression weights in [0, 1.2], a face for each name (of `SCAN_EXPRESSIONS`).

    Raises:
        InputError: The names of the model's expressions are not known.
    """
    columns = _columns(model)
    faces = np.array([SCAN_EXPRESSIONS.index(name) for name in names], int)
    weights = _HELD_POSES[faces] * _strengths(len(faces), _HELD_ASYMMETRY, rng)
    return weights.clip(0, _MAX_WEIGHT) @ columns


def sample_expressions(model: MorphableModel, n: int, rng: np.random.Generator) -> np.ndarray:
    """Random expressive faces: moments of random sequences, or mixtures of two of them.

    Returns:
        `(n, E)` expression weights in [0, 1.2].

    Raises:
        InputError: The names of the model's expressions are not known.
    """
    columns = _columns(model)
    share = np.where(rng.random(n) < 0.5, rng.random(n), 1.0)[:, None]
    weights = share * _moments(n, rng) + (1 - share) * _moments(n, rng)
    others = rng.permuted(np.tile(_NUMBERS_CO_ACTIVE, (n, 1)), axis=1)[:, :_N_CO_ACTIVE]
    weights[np.arange(n)[:, None], others] += rng.uniform(0, _CO_ACTIVITY, others.shape)
    return weights.clip(0, _MAX_WEIGHT) @ columns


def _moments(n: int, rng: np.random.Generator) -> np.ndarray:
    """On the way between two successive poses of a random sequence, `(n, names)`."""
    before = np.concatenate([course[:-1] for course in _COURSES])
    after = np.concatenate([course[1:] for course in _COURSES])
    n_segments = np.array([len(course) - 1 for course in _COURSES])
    sequence = rng.integers(len(_COURSES), size=n)
    segment = (n_segments.cumsum() - n_segments)[sequence] + rng.integers(n_segments[sequence])
    moments = _between(before[segment], after[segment], rng.random(n))
    return moments * _strengths(n, _PERFORMED_ASYMMETRY, rng)


def _strengths(n: int, asymmetry: float, rng: np.random.Generator) -> np.ndarray:
    """Factors on the tabled weight of each expression of a face, `(n, names)`."""
    strength = rng.uniform(*_STRENGTH, (n, 1))
    left, right = rng.uniform(1 - asymmetry, 1 + asymmetry, (2, n, 1))
    return strength * np.where(_IS_LEFT, left, np.where(_IS_RIGHT, right, 1.0))


def _between(before: np.ndarray, after: np.ndarray, place: np.ndarray) -> np.ndarray:
    eased = _ease(place)[:, None]
    return (1 - eased) * before + eased * after


def _ease(place: np.ndarray) -> np.ndarray:
    """Smooth step from 0 at 0 to 1 at 1, and back to 0 at 2."""
    return (1 - np.cos(np.pi * place)) / 2


def _columns(model: MorphableModel) -> np.ndarray:
    """Blendshapes that each name in use moves, `(names, E)` of 0 and 1."""
    number = {name: i for i, name in enumerate(model.expression_names)}
    columns = np.zeros((len(_NAMES), len(number)))
    for row, name in zip(columns, _NAMES, strict=True):
        sided = name.removesuffix("Left").removesuffix("Right")
        side = name.removeprefix(sided)
        spellings = ((name,), (f"{sided}_{side[:1]}",), (f"{name}_L", f"{name}_R"))
        known = next((words for words in spellings if number.keys() >= set(words)), None)
        if known is None:
            raise InputError(
                f"{model.name}: expressions must have the names of ARKit's blendshapes, as those "
                f"of openhead and ict have; use one of these. Received none named {name}."
            )
        row[[number[word] for word in known]] = 1
    return columns
