"""The random streams that training draws from."""

from enum import IntEnum, unique


@unique
class Stream(IntEnum):
    """Random streams of training: `default_rng([seed, Stream.FACE_ORDER, epoch])`.

    Numbers below 100; `experiments.streams` has those from 100 on. None is 0: NumPy pads short
    seeds with zeros, so that `default_rng(s)` equals `default_rng([s, 0])`.
    """

    FACE_ORDER = 1
    SHUFFLED_PAIRS = 2
    RINGS = 3
    LIFTING_SPLIT = 11
    LIFTING_BASIS = 12
    LIFTING_CHECK = 13
    LIFTING_TRAINING = 14
    LIFTING_WEIGHTS = 15
    SHAPES_HELD_OUT = 16
    VIEWS_OF_SHAPES = 17
