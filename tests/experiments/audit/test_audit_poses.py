"""Errors over poses and projections: measured on methods whose errors are known, and verdicts."""

import copy
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from data_gen.models.openhead import load_openhead
from data_gen.views.photo_views import sample_photo_views
from data_gen.views.projections import Cameras, project
from deepmds_keras.networks import build_autoencoder, build_dissimilarity_net, forward
from deepmds_keras.normalisation import normalise, unit
from deepmds_keras.pipeline import DeepMDS
from deepmds_keras.proximities import proximities
from experiments.audit import poses
from experiments.audit.poses import SWEEPS, WITHOUT, kinds, reach, without_autoencoder
from experiments.inputs import Faces
from experiments.recipes import any_way_up
from experiments.verdicts import DOES_NOT_HOLD, HOLDS, WITH_CONDITION

N, L = 8, 10
AUDITED = np.array([1, 6])


class Constant:
    def __init__(self, shape):
        self.shape = shape

    def predict(self, views):
        return np.broadcast_to(self.shape, (len(views), *self.shape.shape))


class AddsDepth:
    """The view, and the depth that the faces have from the front, in their order."""

    def __init__(self, shapes):
        self.shapes = shapes
        self.n_landmarks, self.front_landmark_ = L, 0
        self.dissimilarity_net_ = build_dissimilarity_net()

    def predict(self, views):
        low, size = unit(self.shapes[..., :2])
        depth = (self.shapes[..., 2:] - low) / size
        return np.concatenate([views, np.resize(depth, (len(views), L, 1))], axis=2)

    def frontalise(self, views):
        return views

    def get_params(self):
        return {"n_landmarks": L}


@pytest.fixture(scope="module")
def inputs():
    rng = np.random.default_rng(0)
    landmarks = rng.uniform(-60, 60, (N, L, 3))
    shapes = normalise(landmarks)
    zero = np.zeros(N)
    yaw = np.resize([0.0, 45.0, -45.0, -20.0], N)
    perspective = np.resize([0, 0, 0, 1], N)
    cameras = Cameras(perspective, yaw, zero, zero, 5.0 * perspective)
    views = normalise(project(landmarks, cameras))
    models = {name: AddsDepth(shapes[AUDITED]) for name in ("zhao", "ours", "ours_stable")}
    return SimpleNamespace(
        run=SimpleNamespace(authors=None),
        train=SimpleNamespace(shapes=shapes),
        test=Faces(views, shapes, unit(landmarks)[1].ravel(), shapes, cameras),
        test_dataset=SimpleNamespace(landmarks=landmarks),
        audited=AUDITED,
        scores={m: SimpleNamespace(mse=np.arange(N) + 1.0) for m in ("mean_shape", "ours")},
        method=lambda method: models.get(method, Constant(shapes.mean(0))),
        results=lambda experiment: None,
    )


@pytest.fixture(scope="module")
def measured(inputs, one_thread):
    return poses.measure(inputs)


def swept(measured, method, sweep):
    return dict(zip(SWEEPS[sweep], measured["swept"][method][sweep], strict=True))


def test_constant_answer_depends_on_no_view(measured):
    errors = [mse for own in measured["swept"]["mean_shape"].values() for mse in own]
    np.testing.assert_allclose(errors, errors[0])
    assert errors[0] > 1e-3


def test_frontal_depth_is_right_from_the_front_only(measured):
    for sweep in SWEEPS:
        assert swept(measured, "zhao", sweep)[0] < 1e-20
    for sweep, small, large in (
        ("yaw", 15, 60), ("yaw", -15, -60), ("pitch", 15, 60), ("field_of_view", 10, 60),
    ):  # fmt: skip
        errors = swept(measured, "zhao", sweep)
        assert 1e-6 < errors[small] < errors[large]


def test_curves_have_a_row_for_each_view_and_method(measured):
    rows = pd.DataFrame(measured["curves"])
    methods = [
        *("mean_shape", "linear", "zhao", "aldrian", "ours", "ours_stable", "lifting"),
        WITHOUT,
    ]
    assert rows.groupby("method").size().to_dict() == dict.fromkeys(
        methods, sum(map(len, SWEEPS.values()))
    )
    assert np.isfinite(rows[["mse", "sem"]]).all(axis=None)
    own = rows[(rows["method"] == "zhao") & (rows["sweep"] == "yaw") & (rows["value"] == -30)]
    assert own["mse"].item() == swept(measured, "zhao", "yaw")[-30]


def test_view_itself_is_as_near_to_the_frontal_one_as_it_is_turned(measured):
    own = {sweep: dict(zip(SWEEPS[sweep], values, strict=True))
           for sweep, values in measured["frontal_swept"]["ours"].items()}  # fmt: skip
    assert max(own["roll"].values()) < 1e-6
    assert own["yaw"][0] < 1e-6 < own["yaw"][15] < own["yaw"][45]
    assert measured["frontal_swept"]["constant"] > 0.01
    of_test = measured["frontal_views"]
    assert (
        of_test["view"]["frontal"]["aligned"] < 1e-6 < of_test["view"]["turned by 45°"]["aligned"]
    )
    assert all(own["aligned"] <= own["raw"] for kind in of_test.values() for own in kind.values())


def test_errors_by_kind_are_of_the_views_of_that_kind(measured):
    by_kind = measured["by_kind"]["ours"]
    assert {kind: own["mse"] for kind, own in by_kind.items()} == {
        "turned by -45°": 5, "frontal": 3, "turned by 45°": 4, "perspective": 6,
    }  # fmt: skip
    assert by_kind["frontal"]["sem"] == pytest.approx(2 / 2**0.5)


def test_every_view_is_of_one_kind(inputs):
    assert (np.sum([*kinds(inputs.test.cameras).values()], axis=0) == 1).all()


def test_without_autoencoder_the_net_sees_the_views(inputs):
    model = DeepMDS(L)
    model.autoencoder_, model.dissimilarity_net_ = build_autoencoder(L), build_dissimilarity_net()
    views = inputs.test.views
    bare = without_autoencoder(model)
    np.testing.assert_allclose(bare.frontalise(views), views, atol=1e-6)
    features = proximities(*np.float32(views[:, [2, 7]]).swapaxes(0, 1), "paper")
    expected = forward(model.dissimilarity_net_, features)[:, 0]
    np.testing.assert_allclose(bare.dissimilarities(views)[:, 2, 7], expected, atol=1e-6)


def test_a_stages_model_without_its_autoencoder_does_not_predict_with_it():
    rng = np.random.default_rng(0)
    views, _, _ = sample_photo_views(load_openhead(), "ibug51", 5, rng)
    model = DeepMDS.pretrained("deepmds-ibug51")
    own, bare = (without_autoencoder(m) for m in (model, any_way_up(copy.copy(model))))
    expected = own.predict(views)
    np.testing.assert_array_equal(bare.predict(views), expected)
    assert not np.allclose(model.predict(views), expected)
    assert np.isfinite(bare.predict(-views)).all()
    np.testing.assert_array_equal(bare.predict(views, check_orientation=False), expected)


def test_trained_without_compares_posed_views_of_two_trainings(inputs):
    rows = [
        (variant, seed, metric, factor * (1 + seed))
        for seed in range(3)
        for variant, metric, factor in (
            ("same_face", "mse_posed", 1.0), ("no_autoencoder", "mse_posed", 5.0),
            ("no_autoencoder", "mse", 70.0),
        )
    ]  # fmt: skip
    table = pd.DataFrame(rows, columns=["variant", "seed", "metric", "value"])
    assert poses.trained_without(table) == 5
    assert poses.trained_without(None) is None


@pytest.mark.parametrize(
    ("errors", "reached"),
    [
        ([1, 1, 1, 1, 1], [-30, 30]),
        ([9, 1, 1, 9, 1], [-15, 0]),
        ([1, 9, 1, 1, 9], [0, 15]),
        ([1, 1, 9, 1, 1], None),
    ],
)
def test_reach_ends_at_the_first_error_beyond_the_bound(errors, reached):
    assert reach((-30, -15, 0, 15, 30), errors, 2) == reached


def flat(**errors):
    """Errors of a sweep by method, the same everywhere but where given as `(sweep, index)`."""
    return {sweep: [1e-4] * len(values) for sweep, values in SWEEPS.items()} | errors


def by_kind(ours, stable):
    kinds = ("frontal", "turned by -45°", "perspective")
    errors = {"ours": ours, "ours_stable": stable, "mean_shape": (0.7, 0.7, 0.7)}
    return {
        method: {
            kind: {"mse": 1e-4 * mse, "sem": 1e-6} for kind, mse in zip(kinds, own, strict=True)
        }
        for method, own in errors.items()
    }


SHORT_YAW = {"yaw": [9e-4] * 4 + [1e-4] * 5 + [9e-4] * 4}


@pytest.mark.parametrize(
    ("ours", "stable", "sweeps", "verdict", "condition"),
    [
        ((1, 1.2, 1.4), (1, 1, 1), {}, HOLDS, ""),
        ((1, 1.2, 1.4), (1, 1, 1), SHORT_YAW, WITH_CONDITION, "if the views are like"),
        ((1, 1.2, 1.7), (1, 1, 1.1), {}, WITH_CONDITION, "if the learning rate decays in training"),
        ((1, 1.2, 1.7), (1, 1, 1.1), SHORT_YAW, WITH_CONDITION, "and if the views are like"),
        ((1, 1.2, 1.7), (1, 1, 1.8), {}, DOES_NOT_HOLD, ""),
    ],
)
def test_projection_independent(ours, stable, sweeps, verdict, condition):
    swept = dict.fromkeys(("ours", "ours_stable"), flat(**sweeps))
    finding = poses.projection_independent(by_kind(ours, stable), swept, 51)
    assert finding.verdict == verdict
    assert condition in finding.condition and bool(condition) == bool(finding.condition)
    yaw = "yaw −30° to 30°" if sweeps else "yaw −90° to 90°"
    for text in (yaw, f"{max(ours):.2f} times", f"{max(stable):.3g}", "51 faces", "3 of 3"):
        assert text in finding.evidence


@pytest.mark.parametrize(
    ("errors", "sweeps", "verdict"),
    [
        ((1, 1.2, 1.4), {}, HOLDS),
        ((1, 1.2, 1.4), SHORT_YAW, WITH_CONDITION),
        ((1, 1.2, 1.7), {}, DOES_NOT_HOLD),
    ],
)
def test_lifting_is_judged_as_the_papers_method_is(errors, sweeps, verdict):
    kinds_of = by_kind(errors, errors)
    kinds_of["lifting"] = kinds_of["ours"]
    finding = poses.lifting_independent(kinds_of, {"lifting": flat(**sweeps)}, 51)
    assert finding.verdict == verdict
    assert f"{max(errors):.2f} times" in finding.evidence and "51 faces" in finding.evidence


def frontal_views(ours, stable):
    values = {"view": 0.05, "ours": ours, "ours_stable": stable, "constant": 0.006}
    return {
        name: {kind: {"aligned": own, "raw": 2 * own} for kind in ("turned by 45°", "perspective")}
        | {"frontal": {"aligned": 0.0 if name == "view" else own, "raw": own}}
        for name, own in values.items()
    }


@pytest.mark.parametrize(
    ("ours", "stable", "far", "verdict", "condition"),
    [
        (0.0051, 0.004, 0.0052, HOLDS, ""),
        (0.0051, 0.004, 0.03, WITH_CONDITION, "if the views are like those it was trained on"),
        (0.0071, 0.004, 0.0052, WITH_CONDITION, "if the learning rate decays in training"),
        (0.0071, 0.0072, 0.0052, DOES_NOT_HOLD, ""),
        (0.0711, 0.0722, 0.0052, DOES_NOT_HOLD, ""),
    ],
)
def test_frontal_view(ours, stable, far, verdict, condition):
    own = {sweep: [0.005] * (len(values) - 1) + [far] for sweep, values in SWEEPS.items()}
    swept = {"ours": own, "ours_stable": own, "constant": 0.006}
    finding = poses.frontal_view(frontal_views(ours, stable), swept)
    assert (finding.verdict, finding.condition) == (verdict, condition)
    reached = "yaw −90° to 75°" if far > 0.006 else "yaw −90° to 90°"
    for text in (f"{ours:.2g} to", f"{stable:.2g} to", "0.006 to", reached):
        assert text in finding.evidence


@pytest.mark.parametrize(
    ("without", "trained", "verdict"),
    [
        (20, None, HOLDS),
        (20, 3.21, HOLDS),
        (20, 1.21, WITH_CONDITION),
        (1.4, 3.21, DOES_NOT_HOLD),
    ],
)
def test_autoencoder_needed(without, trained, verdict):
    turned = {sweep: [1e-4 * (without if v else 1) for v in SWEEPS[sweep]] for sweep in SWEEPS}
    swept = {"ours": flat(), "mean_shape": flat(), WITHOUT: turned}
    finding = poses.autoencoder_needed(swept, trained, 51)
    assert finding.verdict == verdict
    texts = [f"{without:.2f} times that", "1.0000 times as high on frontal", "51 faces"]
    for text in [*texts, *[f"{trained} times"] * (trained is not None)]:
        assert text in finding.evidence
