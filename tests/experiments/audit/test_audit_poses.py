"""Topics on views, by methods whose errors are known: poses, noise, perspective."""

from types import SimpleNamespace

import numpy as np
import pytest
from faces import cameras

from deepmds_keras.geometry.units import normalise, unit
from deepmds_keras.geometry.views import project
from deepmds_keras.landmarks import load_scheme
from experiments.audit import poses
from experiments.audit.poses import NOISE_PERCENTS, SWEEPS
from experiments.inputs import Faces

N, L = 8, 72
AUDITED = np.array([1, 3, 4, 6])
SCHEME = load_scheme("bfm72")
CORNERS = [SCHEME.names.index(f"{side}_eye_outer_corner") for side in ("right", "left")]


class AddsDepth:
    """The view, and the depth that the faces have from the front, in their order."""

    n_landmarks = L

    def __init__(self, shapes):
        self.shapes = shapes

    def predict(self, views):
        low, size = unit(self.shapes[..., :2])
        depth = (self.shapes[..., 2:] - low) / size
        return np.concatenate([views, np.resize(depth, (len(views), L, 1))], axis=2)


@pytest.fixture(scope="module")
def evidence():
    landmarks = np.random.default_rng(0).uniform(-60, 60, (N, L, 3))
    landmarks[:, CORNERS[1]] = landmarks[:, CORNERS[0]] + (60, 0, 80)
    shapes, frontal = normalise(landmarks), cameras(np.zeros(N))
    views = project(landmarks, frontal)
    faces = Faces(normalise(views), shapes, unit(landmarks)[1].ravel(), shapes, frontal)
    models = {name: AddsDepth(shapes[AUDITED]) for name in ("zhao", "deep_mds", "deep_mds_cosine")}
    mean = SimpleNamespace(predict=lambda views: np.stack([shapes.mean(0)] * len(views)))
    return SimpleNamespace(
        run=SimpleNamespace(authors=None, scheme="bfm72"),
        test=faces,
        audited=AUDITED,
        views=views[AUDITED],
        shapes=shapes[AUDITED],
        landmarks=landmarks[AUDITED],
        rng=lambda stream: np.random.default_rng([0, stream]),
        method=lambda method: models.get(method, mean),
    )


@pytest.fixture(scope="module")
def curves(evidence, one_thread):
    return poses.poses(evidence)


@pytest.fixture(scope="module")
def noise(evidence, one_thread):
    return poses.noise(evidence)


def errors(table, method, sweep="noise_percent"):
    """Errors by what is varied."""
    rows = table[(table["method"] == method) & (table["sweep"] == sweep)]
    return rows.set_index("value")["mse"]


def test_constant_answer_depends_on_no_view(curves, noise):
    for table in (curves, noise):
        mse = table.loc[table["method"] == "mean_shape", "mse"].to_numpy()
        np.testing.assert_allclose(mse, mse[0])
        assert mse[0] > 1e-3


def test_frontal_depth_is_right_from_the_front_only(curves):
    for sweep in SWEEPS:
        assert errors(curves, "zhao", sweep)[0] < 1e-20
    for sweep, small, large in (
        ("yaw", 15, 60), ("yaw", -15, -60), ("pitch", 15, 60), ("field_of_view", 10, 60),
    ):  # fmt: skip
        mse = errors(curves, "zhao", sweep)
        assert 1e-6 < mse[small] < mse[large]


def test_every_method_has_every_view(curves, noise):
    assert {*curves["method"]} == {*poses._POSED}
    assert (curves.groupby("method").size() == sum(map(len, SWEEPS.values()))).all()
    assert (noise.groupby("method").size() == len(NOISE_PERCENTS)).all()
    assert np.isfinite(curves[["mse", "sem"]]).all(axis=None)


def test_noise_is_a_share_of_the_interocular_distance(evidence, noise):
    mse = errors(noise, "deep_mds")
    assert mse[0] < 1e-20
    for percent in (1, 2):
        # The distance is 100 mm, in three dimensions. Two of three coordinates have noise.
        expected = np.mean((percent / evidence.test.unit_mm[AUDITED]) ** 2) * 2 / 3
        assert mse[percent] == pytest.approx(expected, rel=0.1)


def test_authors_weights_are_measured_where_they_are_given(evidence, noise):
    run = SimpleNamespace(**vars(evidence.run) | {"authors": "folder"})
    given = poses.noise(SimpleNamespace(**vars(evidence) | {"run": run}))
    assert {*given["method"]} - {*noise["method"]} == {"deep_mds_weights"}


def test_released_views_are_orthographic_but_for_rounding_and_the_texts_are_not(evidence):
    table = poses.perspective(evidence).set_index("views")
    assert table.loc["released", "max"] < 1e-12
    assert 0.001 < table.loc["text", "rms"] < table.loc["text", "max"] < 0.1
