"""Examples in the documentation of the public names run, and what they lift are faces."""

import doctest
import importlib

import numpy as np

import deepmds_keras
from deepmds_keras import load_scheme

MODULES = sorted({getattr(deepmds_keras, name).__module__ for name in deepmds_keras._HOME})
GROUPS = np.array(load_scheme("ibug51").groups)


def is_face(shape):
    """Whether brows are above mouth and chin, and the nose in front: `(51, 3)`, y up."""
    brows, nose, mouth = (
        shape[[part in group for group in GROUPS]].mean(0) for part in ("brow", "nose", "mouth")
    )
    return np.isfinite(shape).all() and brows[1] > nose[1] > mouth[1] and nose[2] > brows[2]


def test_examples_run_and_lift_faces():
    lifted = []
    for module in map(importlib.import_module, MODULES):
        for test in doctest.DocTestFinder().find(module):
            result = doctest.DocTestRunner().run(test, clear_globs=False)
            assert not result.failed, test.name
            if result.attempted:
                lifted += [test.globs[name] for name in ("shape", "shapes") if name in test.globs]
    assert len(lifted) == 2 and all(map(is_face, lifted)), "by either method"
