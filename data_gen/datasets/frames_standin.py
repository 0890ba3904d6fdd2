"""The open stand-in for the CoMA data set: subjects who perform expression sequences.

CoMA (Ranjan et al. 2018, doi:10.1007/978-3-030-01219-9_43) has 12 subjects, 12 sequences and
20,466 frames, and may be had on request only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_gen.models.expressions import SEQUENCES, sequence_weights
from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.errors import InputError

_LEAST = 3  # frames of a performance: neutral, something, neutral


@dataclass(frozen=True, eq=False)
class Frames:
    """Frames of the performances, by subject, then sequence, then time.

    Attributes:
        identity: `(n, K)` float32, coefficients of the morphable model, those of the subject.
        expression: `(n, E)` float32, its expression weights.
        subject: `(n,)` int, number of the subject, from 0.
        sequence: `(n,)` int, index into `SEQUENCES`.
    """

    identity: np.ndarray
    expression: np.ndarray
    subject: np.ndarray
    sequence: np.ndarray

    def __len__(self) -> int:
        return len(self.subject)


def make_frames(
    model: MorphableModel, n_subjects: int, n_frames: int, rng: np.random.Generator
) -> Frames:
    """Every subject performs every sequence once; the numbers of frames differ by 1 at most.

    Args:
        model: Morphable model with named expressions.
        n_subjects: Number of subjects, each of standard-normal identity coefficients.
        n_frames: Number of frames of all performances together.
        rng: Source of the random numbers.

    Raises:
        InputError: Too few frames for so many performances, or the names of the model's expressions
            are not known.
    """
    n_performances = n_subjects * len(SEQUENCES)
    if n_subjects < 1:
        raise InputError(f"n_subjects must be at least 1. Received {n_subjects}.")
    if n_frames < _LEAST * n_performances:
        raise InputError(
            f"n_frames must be at least {_LEAST * n_performances} for {n_subjects} subjects, "
            f"{_LEAST} a performance. Received {n_frames}."
        )
    identity = np.float32(rng.standard_normal((n_subjects, model.n_identity)))
    lengths = np.diff(np.arange(n_performances + 1) * n_frames // n_performances)
    performance = np.repeat(np.arange(n_performances), lengths)
    subject, sequence = np.divmod(performance, len(SEQUENCES))
    performed = zip(SEQUENCES * n_subjects, lengths, strict=True)
    expression = [sequence_weights(model, name, length, rng) for name, length in performed]
    return Frames(identity[subject], np.float32(np.concatenate(expression)), subject, sequence)
