"""What MDS adds to a network's own shapes: nothing to shapes, something to what is none."""

from types import SimpleNamespace

import numpy as np
import pytest

from deepmds_keras.embedding import pairwise_distances
from deepmds_keras.normalisation import normalise
from experiments.audit import lifted_distances
from experiments.verdicts import DOES_NOT_HOLD, HOLDS

N, L = 3, 24


class Lifter:
    """Shapes that are a little off, as float32."""

    def __init__(self, shapes):
        self.shapes = shapes

    def predict(self, views):
        off = 0.02 * np.random.default_rng(1).standard_normal(self.shapes.shape)
        return np.float32(self.shapes + off)


class DeepMDS:
    """Dissimilarities of no shape."""

    def __init__(self, shapes):
        self.shapes = shapes

    def dissimilarities(self, views):
        noise = np.random.default_rng(2).random((N, L, L))
        return pairwise_distances(self.shapes) * (1 + (noise + noise.swapaxes(1, 2)) / 4)


class Faces:
    """Test faces, each its own view."""

    def __init__(self, shapes):
        self.views, self.shapes = shapes[..., :2], shapes

    def __getitem__(self, faces):
        return Faces(self.shapes[faces])


@pytest.fixture(scope="module")
def measured():
    shapes = normalise(np.random.default_rng(0).normal(0, (3, 2, 1), (2 * N, L, 3)))
    audited = np.arange(1, 2 * N, 2)
    methods = {"lifting": Lifter(shapes[audited]), "ours": DeepMDS(shapes[audited])}
    inputs = SimpleNamespace(test=Faces(shapes), audited=audited, method=methods.get)
    return lifted_distances.measure(inputs)


def test_scikit_learns_mds_gives_the_shapes_to_rounding(measured):
    assert measured["n_faces"] == N
    assert measured["moved"] < 1e-14
    assert measured["stress"] < 1e-14 < 0.01 < measured["learnt_stress"]
    assert measured["error"] == pytest.approx(0.02, rel=0.2), "root mean square of a coordinate"
    finding = lifted_distances.nothing_added(**measured)
    assert finding.verdict == HOLDS
    assert f"in {N} test faces" in finding.evidence


def test_shapes_that_mds_changes_are_found(measured):
    changed = measured | {"moved": 1e-6 * measured["error"]}
    assert lifted_distances.nothing_added(**changed).verdict == DOES_NOT_HOLD
