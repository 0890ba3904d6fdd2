"""The random streams of a run, declared once: `default_rng([run.seed, Stream.SUBSETS])`."""

from enum import IntEnum, unique


@unique
class Stream(IntEnum):
    """Number after the seed; numbers of files, subjects or photos may follow it."""

    TRAIN_FACES = 101
    TEST_FACES = 102
    SUBSETS = 103
    IMAGES = 104
    FRAMES = 105
    SCANS = 106
    RINGS = 107
    RING_IMAGES = 108
    PHOTOS = 109
    PRETRAINED = 110
    BENCH = 111
    STREAMED_FACES = 112
    PORTRAITS = 113
    PHOTO_FACES = 114
    SUBSTITUTE_PHOTOS = 115
    LANDMARK_NOISE = 116
    OBJECTS = 117
    PEOPLE = 118
    AUDITED_FACES = 201
    AUDIT_CAMERAS = 202
    AUDIT_CRITERIA = 204
    AUDIT_DISSIMILARITY = 205
    AUDIT_NOISE = 207
    AUDIT_SIGNIFICANCE = 209
    HARD_FACES = 301
    HARD_TRAINING = 302
    HARD_MISSING = 303
    HARD_BOUND = 304
    COMPONENT_BOUND = 311
    TRANSFER_TRAINING = 312
    TRANSFER_TESTS = 313
    SURFACES = 321
    RELEASED_WEIGHTS_FACES = 331
    RELEASED_WEIGHTS_TRAINING = 332
