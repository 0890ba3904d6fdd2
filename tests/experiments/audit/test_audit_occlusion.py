"""Landmarks not seen: what hides them, what stands in for them, and verdicts both ways."""

from types import SimpleNamespace

import numpy as np
import pytest

from data_gen.models.morphable_model import MorphableModel
from data_gen.views.projections import Cameras, in_camera_frame, project
from deepmds_keras.baselines.linear import Linear
from deepmds_keras.networks import build_dissimilarity_net
from deepmds_keras.normalisation import normalise, unit
from experiments.audit import occlusion
from experiments.inputs import Faces
from experiments.verdicts import DOES_NOT_HOLD, HOLDS, WITH_CONDITION

RADIUS, L = 50.0, 24


def sphere():
    """Vertices and triangles of a sphere, of which every landmark is a vertex."""
    rings, sides = 40, 60
    latitude = np.linspace(0.01, np.pi - 0.01, rings)[:, None]
    longitude = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    vertices = RADIUS * np.stack(
        [
            np.sin(latitude) * np.cos(longitude),
            np.cos(latitude) * np.ones(sides),
            np.sin(latitude) * np.sin(longitude),
        ],
        axis=-1,
    )
    number = np.arange(rings * sides).reshape(rings, sides)
    a, b = number[:-1], number[1:]
    c, d = np.roll(a, 1, axis=1), np.roll(b, 1, axis=1)
    triangles = np.stack([np.stack([a, b, c], -1), np.stack([c, b, d], -1)], 2).reshape(-1, 3)
    return vertices.reshape(-1, 3), triangles


@pytest.fixture(scope="module")
def inputs():
    """Spheres and ellipsoids, frontal and turned; landmarks all around them."""
    rng = np.random.default_rng(0)
    vertices, triangles = sphere()
    chosen = rng.choice(len(vertices), L, replace=False)
    basis = np.stack([0.1 * vertices, 0.1 * vertices * (1, 0, 0)])
    model = MorphableModel("ball", vertices, basis, triangles, {"bfm72": chosen})

    def faces(n):
        identity, whole = model.sample(n, rng)
        zero = np.zeros(n)
        yaw = np.resize([0.0, 45.0, -45.0], n)
        cameras = Cameras(zero.astype(int), yaw, zero, zero, zero)
        landmarks = whole[:, chosen]
        views = project(landmarks, cameras)
        dataset = SimpleNamespace(
            identity=identity, landmarks=landmarks, views=views, cameras=cameras
        )
        normalised, shapes = normalise(views), normalise(landmarks)
        return dataset, Faces(normalised, shapes, unit(landmarks)[1].ravel(), shapes, cameras)

    (train_dataset, train), (test_dataset, test) = faces(300), faces(3)
    linear = Linear().fit(train.views, train.shapes)
    # Ours is as the regression, so that only what is without an autoencoder need be embedded.
    ours = SimpleNamespace(
        predict=linear.predict,
        n_landmarks=L,
        dissimilarity_net_=build_dissimilarity_net(),
        front_landmark_=0,
        get_params=lambda: {"n_landmarks": L},
    )
    return SimpleNamespace(
        run=SimpleNamespace(seed=0),
        scheme=SimpleNamespace(name="bfm72"),
        model=model,
        train_dataset=train_dataset,
        test_dataset=test_dataset,
        test=test,
        audited=np.arange(3),
        method=lambda method: linear if method == "linear" else ours,
    )


@pytest.fixture(scope="module")
def measured(inputs, one_thread):
    return occlusion.measure(inputs)


def test_half_of_a_sphere_is_hidden(inputs, measured):
    posed = [1, 2]
    cameras = inputs.test.cameras[posed]
    depth = in_camera_frame(inputs.test_dataset.landmarks[posed], cameras)[..., 2]
    behind = (depth < -1).sum(1)  # by the tolerance, those at the rim are seen
    by_kind = measured["hidden_by_kind"]
    assert [*by_kind] == ["turned by -45°", "turned by 45°"]
    assert by_kind["turned by 45°"] == pytest.approx(behind[0], abs=1)
    assert by_kind["turned by -45°"] == pytest.approx(behind[1], abs=1)
    assert measured["n_posed"] == 2
    assert measured["n_landmarks"] == L


def test_errors_with_all_landmarks_are_those_of_the_test_views(inputs, measured):
    linear = inputs.method("linear")
    posed = inputs.test[[1, 2]]
    expected = occlusion.score(linear.predict(posed.views), posed).mse.mean()
    assert measured["occluded"]["all"]["linear"] == pytest.approx(expected, rel=1e-6)


def test_curves_begin_with_nothing_missing_and_grow(measured):
    curves = {(row["sweep"], row["method"], row["value"]): row["mse"] for row in measured["curves"]}
    assert len(curves) == len(measured["curves"]) == 2 * 5 * 4
    for method in ("linear", "ours", "ours_stable", "without_autoencoder"):
        first = {curves[sweep, method, 0] for sweep in occlusion.SWEEPS.values()}
        assert len(first) == 1
    mean = [curves["missing_percent", "linear", percent] for percent in occlusion.PERCENTAGES]
    regression = [
        curves["missing_percent_regression", "linear", percent] for percent in occlusion.PERCENTAGES
    ]
    assert mean[-1] > 1.2 * mean[0]
    assert all(few < many for few, many in zip(regression[1:], mean[1:], strict=True))
    assert measured["thinned"]["mean"][2] == [10, curves["missing_percent", "ours", 10]]


def test_regression_comes_nearer_than_the_mean_place(measured):
    assert measured["off_mm"]["regression"] < 0.1 * measured["off_mm"]["mean"]
    assert measured["off_mm"]["mean"] > 10


def test_stand_ins_leave_what_is_seen_as_it_is(inputs):
    rng = np.random.default_rng(1)
    views = inputs.test_dataset.views
    missing = rng.random(views.shape[:2]) < 0.3
    mean = inputs.train_dataset.views.mean(0)
    for name, put in occlusion.stand_ins(inputs.train_dataset.views).items():
        before = views.copy()
        filled = put(views, missing)
        np.testing.assert_array_equal(views, before)
        np.testing.assert_array_equal(filled[~missing], views[~missing])
        if name == "mean":
            np.testing.assert_allclose(filled[missing], np.tile(mean, (3, 1, 1))[missing])


@pytest.mark.parametrize(
    ("mean", "regression", "verdict"),
    [
        (1.2e-4, 1.0e-4, HOLDS),
        (21e-4, 1.1e-4, WITH_CONDITION),
        (21e-4, 1.7e-4, DOES_NOT_HOLD),
    ],
)
def test_occlusion(mean, regression, verdict):
    finding = occlusion.occlusion(
        hidden_by_kind={"turned by -45°": 16.8, "perspective": 11.9},
        off_mm={"mean": 53.2, "regression": 1.13},
        occluded={
            name: {"ours": mse, "without_autoencoder": 3 * mse}
            for name, mse in (("all", 1e-4), ("mean", mean), ("regression", regression))
        },
        n_landmarks=72,
        n_posed=61,
    )
    assert finding.verdict == verdict
    for text in ("17 in views that are turned by −45°", "61 posed", "53 mm", "1.1 mm"):
        assert text in finding.evidence
    assert f"{mean / 1e-4:.2f} times" in finding.evidence


@pytest.mark.parametrize(
    ("mean", "regression", "verdict", "condition"),
    [
        ([1.1, 1.2, 1.4], [1, 1, 1], HOLDS, ""),
        ([1.1, 1.2, 1.6], [1, 1.7, 1], WITH_CONDITION, "up to 10 % are missing"),
        ([2.5, 5.5, 9.5], [1, 1, 1.1], WITH_CONDITION, occlusion.ESTIMATED),
        (
            [2.5, 5.5, 9.5],
            [1, 1.6, 1.1],
            WITH_CONDITION,
            f"{occlusion.ESTIMATED} and up to 5 % are missing",
        ),
        ([2.5, 5.5, 9.5], [1.6, 1.7, 1.8], DOES_NOT_HOLD, ""),
    ],
)
def test_missing_landmarks(mean, regression, verdict, condition):
    percentages = (0, 5, 10, 20)
    thinned = {
        name: [[n, 2e-4 * ratio] for n, ratio in zip(percentages, [1, *ratios], strict=True)]
        for name, ratios in (("mean", mean), ("regression", regression))
    }
    finding = occlusion.missing_landmarks(thinned, 43)
    assert (finding.verdict, finding.condition) == (verdict, condition)
    for text in ("43 faces", f"{mean[0]:.2f} times with 5 %", f"{max(regression):.2f} times with"):
        assert text in finding.evidence
