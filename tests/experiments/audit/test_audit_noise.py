"""Landmark noise: its size, what it does where that is known, and verdicts both ways."""

from types import SimpleNamespace

import numpy as np
import pytest

from deepmds_keras.landmarks import load_scheme
from deepmds_keras.normalisation import normalise, unit
from experiments.audit import noise
from experiments.inputs import Faces
from experiments.verdicts import DOES_NOT_HOLD, HOLDS, WITH_CONDITION

N, L = 12, 72
SCHEME = load_scheme("bfm72")
CORNERS = [SCHEME.names.index(f"{side}_eye_outer_corner") for side in ("right", "left")]


class Constant:
    def __init__(self, shape):
        self.shape = shape

    def predict(self, views):
        return np.broadcast_to(self.shape, (len(views), L, 3))


class AddsTrueDepth:
    """The view, and the depth of the faces in its order, however often they come."""

    def __init__(self, shapes):
        self.shapes = shapes

    def predict(self, views):
        low, size = unit(self.shapes[..., :2])
        depth = (self.shapes[..., 2:] - low) / size
        return np.concatenate([views, np.resize(depth, (len(views), L, 1))], axis=-1)


@pytest.fixture(scope="module")
def inputs():
    landmarks = np.random.default_rng(0).uniform(-70, 70, (2 * N, L, 3))
    landmarks[:, CORNERS[1]] = landmarks[:, CORNERS[0]] + (60, 0, 80)
    shapes = normalise(landmarks)
    audited = np.arange(0, 2 * N, 2)
    nothing = np.zeros(2 * N)
    models = {"ours": AddsTrueDepth(shapes[audited])}
    return SimpleNamespace(
        run=SimpleNamespace(seed=0, authors=None),
        test=Faces(shapes[..., :2], shapes, unit(landmarks)[1].ravel(), shapes, nothing),
        test_dataset=SimpleNamespace(views=landmarks[..., :2], landmarks=landmarks),
        audited=audited,
        scheme=SCHEME,
        method=lambda method: models.get(method, Constant(shapes.mean(0))),
    )


def test_interocular_distance_is_in_three_dimensions(inputs):
    distances = noise.interocular_distances(inputs.test_dataset.landmarks, SCHEME)
    np.testing.assert_allclose(distances, 100)


def test_noise_has_the_size_that_it_is_said_to_have(inputs):
    measured = noise.measure(inputs)
    assert measured["n_faces"] == N
    ours = {row["value"]: row["mse"] for row in measured["curves"] if row["method"] == "ours"}
    assert sorted(ours) == list(noise.PERCENTS)
    assert ours[0] < 1e-20
    for percent in (1, 2):
        # Of a coordinate in normalised units, in two of three coordinates.
        expected = np.mean((percent / inputs.test.unit_mm[inputs.audited]) ** 2) * 2 / 3
        assert ours[percent] == pytest.approx(expected, rel=0.1)


def test_an_answer_that_ignores_the_view_does_not_change(inputs):
    rows = [row for row in noise.measure(inputs)["curves"] if row["method"] == "mean_shape"]
    assert np.ptp([row["mse"] for row in rows]) < 1e-12
    truth = inputs.test[inputs.audited]
    of_faces = noise.mean_errors(inputs.method("mean_shape"), truth.views[None], truth)
    for row in rows:
        assert row["sweep"] == "noise_percent"
        assert row["sem"] == pytest.approx(of_faces.std(ddof=1) / N**0.5)


def test_authors_weights_are_measured_where_they_are_given(inputs):
    given = SimpleNamespace(**vars(inputs) | {"run": SimpleNamespace(seed=0, authors="folder")})
    methods = [{row["method"] for row in noise.measure(i)["curves"]} for i in (inputs, given)]
    assert methods[1] - methods[0] == {"authors_weights"}


def curves(errors, mean_shape=1.0):
    rows = {"ours": errors, "mean_shape": [mean_shape] * len(errors)}
    rows["linear"] = [0.1 * 2**k for k in range(len(errors))]
    return [
        {"sweep": "noise_percent", "value": percent, "method": method, "mse": mse, "sem": 0.0}
        for method, own in rows.items()
        for percent, mse in zip((0, 1, 2, 5), own, strict=True)
    ]


def test_an_error_that_stays_alike_withstands_noise():
    finding = noise.withstands(curves([0.2, 0.21, 0.25, 0.29]), 200, interocular_percent=5)
    assert finding.verdict == HOLDS
    assert "1.45 times, from 0.2 to 0.29" in finding.evidence
    assert "Linear 8.00 times, to 0.8" in finding.evidence
    assert "better at every size" in finding.evidence


def test_noise_is_withstood_up_to_the_first_size_that_is_not():
    finding = noise.withstands(curves([0.2, 0.21, 0.31, 0.29], 0.3), 200, interocular_percent=5)
    assert finding.verdict == WITH_CONDITION
    assert finding.condition.startswith("up to 1 %")
    assert "worse than it from 2 % on" in finding.evidence
    assert noise.withstands(curves([0.2, 0.21, 0.31, 0.9]), 200, 1).verdict == HOLDS


def test_noise_beyond_what_was_measured_is_not_said_to_be_withstood():
    finding = noise.withstands(curves([0.2] * 4), 200, interocular_percent=8)
    assert finding.verdict == WITH_CONDITION
    assert finding.condition.startswith("up to 5 %")


def test_an_error_that_grows_at_once_does_not_withstand_noise():
    finding = noise.withstands(curves([0.2, 0.4, 0.6, 0.8]), 200, interocular_percent=5)
    assert finding.verdict == DOES_NOT_HOLD
    assert "4.00 times" in finding.evidence
