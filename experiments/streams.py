"""The random streams of a run, each declared here: `default_rng([run.seed, Stream.SUBSETS])`.

Streams inside `deepmds_keras`, of initial weights and of mini-batches, are declared there.
"""

from __future__ import annotations

from enum import IntEnum


class Stream(IntEnum):
    """Number that stands after the seed; those of single files, subjects or photos follow it.

    NumPy pads short seeds with zeros: `default_rng(s)`, `default_rng([s, 0])` and
    `default_rng([s, 0, 0])` give the same numbers.
    """

    TRAIN_FACES = 0
    TEST_FACES = 1
    SUBSETS = 2
    IMAGES = 3
    FRAMES = 4
    SCANS = 5
    RINGS = 6
    RING_IMAGES = 7
    PHOTOS = 7  # the same as RING_IMAGES
    PRETRAINED = 8
    BENCH = 9
    STREAMED_FACES = 10
    # Of the audit, all the same as another.
    AUDIT_COMPLEXITY = 0  # TRAIN_FACES
    AUDIT_CRITERIA = 0
    AUDIT_DISSIMILARITY = 0
    AUDIT_NOISE = 0
    AUDIT_RANKING = 0
    AUDIT_SIGNIFICANCE = 0
    AUDITED_FACES = 3  # IMAGES
    AUDIT_CAMERAS = 4  # FRAMES
    AUDIT_MISSING = 5  # SCANS
