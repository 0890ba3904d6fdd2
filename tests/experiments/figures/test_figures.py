"""Laws of the figures: conventions of the views, units on the axes, equal bytes, small files."""

import numpy as np
import pandas as pd
import pytest
from places import SHARED

from data_gen.datasets.dataset import make_dataset
from data_gen.datasets.images import make_scene, render
from data_gen.models.openhead import load_openhead
from deepmds_keras.landmarks import load_scheme
from experiments.figures import style
from experiments.figures.curves import batchnorm_lag, learning_curves
from experiments.figures.errors import error_per_condition, error_per_landmark, error_per_pose
from experiments.figures.ground_truth import Example, ground_truth
from experiments.figures.qualitative import Photos, qualitative
from experiments.figures.renders import renders
from experiments.figures.summary import seed_spread, summary
from experiments.figures.wireframe import draw_wireframe, front_view, side_view

OPEN_HEAD = SHARED / "openhead" / "open_head_199_f16.npz"
SCHEME = load_scheme("bfm72")
N_LANDMARKS = 72
PAPER_METHODS = (
    *("mean_shape", "linear", "zhao", "zhao_authors", "zhao_frontal", "aldrian"),
    *("mobileface", "ours", "ours_released", "ours_stable", "authors_weights"),
)


def random_face(rng):
    return rng.uniform(0, 1, (N_LANDMARKS, 3))


def draw_qualitative(faces, methods, rng):
    predictions = {m: faces + rng.normal(0, 0.01, faces.shape) for m in methods}
    scores = {m: np.mean((p - faces) ** 2, axis=(1, 2)) for m, p in predictions.items()}
    titles = [f"Projection {row}" for row in range(len(faces))]
    views = faces @ [[0.7, 0], [0, 1], [-0.7, 0]]
    return qualitative(views, faces[..., :2], faces, predictions, SCHEME, titles, scores)


RECORD = {"train": [2e-4, 1e-4], "inference": [9e-4, 4e-4]}


def draw_learning(rng):
    histories = {"ours": {"autoencoder": RECORD, "dissimilarity_net": RECORD}}
    record = {"train": [9.0, 2.0], "inference": [7.0, 3.0]}
    return learning_curves(histories, mobileface=record, ringnet=record)


def draw_lag(rng):
    record = RECORD | {"reestimated": 1.6e-5}
    return batchnorm_lag({"constant": {0: record, 1: record}, "cosine": {0: record}})


def draw_landmarks(rng):
    errors = {m: rng.uniform(1, 9, N_LANDMARKS) for m in ("ours", "linear")}
    return error_per_landmark(errors, SCHEME, random_face(rng))


def pose_errors(rng, n=60):
    perspective = np.arange(n) % 2 == 1
    return pd.DataFrame(
        {
            "method": np.repeat(["ours", "linear"], n // 2),
            "projection": np.where(perspective, "perspective", "orthographic"),
            "yaw": np.where(perspective, -rng.uniform(0, 45, n), rng.choice([-45, 0, 45], n)),
            "pitch": np.where(perspective, -rng.uniform(0, 30, n), 0),
            "mse": rng.uniform(1e-5, 1e-3, n),
        }
    )


def draw_poses(rng):
    return error_per_pose(pose_errors(rng))


def condition_errors(rng, n=60):
    return pd.DataFrame(
        {
            "method": np.repeat(["ours", "linear"], n // 2),
            "condition": np.resize(["neutral", "eyes_closed"], n),
            "mse": rng.uniform(1e-5, 1e-3, n),
        }
    )


def draw_conditions(rng):
    return error_per_condition(condition_errors(rng))


IBUG = load_scheme("ibug51")


def draw_ground_truth(rng):
    truth = rng.normal(0, 30, (6, 51, 3))
    found = truth + rng.normal(0, 2, truth.shape)
    examples = [
        Example(
            image=rng.integers(0, 255, (32, 32, 3), np.uint8),
            detected=rng.uniform(0, 32, (51, 2)),
            points=rng.normal(0, 40, (500, 3)),
            fitted=face,
            found=face,
            truth=face,
        )
        for face in truth[:2]
    ]
    return ground_truth(examples, IBUG, found, truth)


def draw_seeds(rng):
    rows = [
        (method, seed, "mse", rng.uniform(1e-4, 1e-3))
        for method in ("ours", "ours_stable")
        for seed in range(3)
    ]
    return seed_spread(pd.DataFrame(rows, columns=["method", "seed", "metric", "value"]))


def headline_table():
    nan = np.nan
    return pd.DataFrame(
        [
            ("linear", "mse", 3e-6, 1e-7, nan, nan),
            ("linear", "depth_corr", 71.999, 1e-4, nan, nan),
            ("ours", "mse", 1.5e-4, 2e-6, 1.4e-4, 5e-7),
            ("ours", "depth_corr", 71.94, 0.002, 71.95, 0.002),
            ("mobileface", "mse", nan, nan, 6e-5, 4e-7),
            ("mobileface", "depth_corr", nan, nan, 71.97, 0.002),
        ],
        columns=["method", "metric", "mean", "std", "paper_mean", "paper_std"],
    )


def draw_summary(rng):
    return summary(headline_table(), "bfm")


def draw_small_qualitative(rng):
    return draw_qualitative(np.stack([random_face(rng)]), ("ours", "linear"), rng)


PLOTS = [
    *(draw_learning, draw_lag, draw_landmarks, draw_poses, draw_conditions, draw_seeds),
    *(draw_summary, draw_ground_truth),
]


def texts(axes):
    return [text.get_text() for text in axes.texts]


def test_a_figure_of_a_small_preset_says_so(tmp_path):
    for name, said in (("openhead", []), ("smoke", ["smoke: too short to mean anything"])):
        figure = draw_summary(None)
        style.save(figure, tmp_path / name / "figures", "summary")
        assert [text.get_text() for text in figure.texts] == said


@pytest.mark.slow
@pytest.mark.parametrize("draw", [*PLOTS, draw_small_qualitative])
def test_equal_inputs_give_equal_bytes(draw, tmp_path):
    first = style.save(draw(np.random.default_rng(0)), tmp_path / "first", "figure")
    second = style.save(draw(np.random.default_rng(0)), tmp_path / "second", "figure")
    for one, other in zip(first, second, strict=True):
        assert one.read_bytes() == other.read_bytes()
        assert one.stat().st_size < 300_000


def test_saving_leaves_only_the_two_files(tmp_path):
    style.save(draw_summary(None), tmp_path / "figures", "summary")
    names = sorted(path.name for path in (tmp_path / "figures").iterdir())
    assert names == ["summary.pdf", "summary.png"]


def test_the_pdf_holds_no_date(tmp_path):
    _, pdf = style.save(draw_summary(None), tmp_path, "summary")
    assert b"CreationDate" not in pdf.read_bytes()


@pytest.mark.parametrize("draw", PLOTS)
def test_every_quantity_on_a_value_axis_has_its_unit(draw):
    units = ("(mm)", "(mm²)", "(%)", "units)", "(°)", "epochs)", "steps)", "(no unit)")
    for axes in draw(np.random.default_rng(0)).axes:
        if not axes.axison:
            continue
        for label in filter(None, (axes.get_xlabel(), axes.get_ylabel())):
            assert any(unit in label for unit in units), label


def test_subjects_left_is_on_the_right_of_the_front_view():
    left_ear, right_ear = front_view(np.array([[60.0, 0, 0], [-60.0, 0, 0]]))
    assert left_ear[0] > right_ear[0]


def test_nose_of_the_side_view_points_to_the_right_with_the_brow_above():
    nose_tip, brow, ear = side_view(np.array([[0.0, 0, 130], [0, 40, 110], [60, 10, 20]]))
    assert nose_tip[0] > brow[0] > ear[0]
    assert brow[1] > nose_tip[1]


def test_wireframe_joins_the_landmarks_of_each_polyline():
    figure = style.Figure()
    axes = figure.add_subplot()
    points = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    draw_wireframe(axes, points, ((0, 1, 2), (3, 0)), colour="black")
    lines, dots = axes.collections
    drawn = [line.tolist() for line in lines.get_segments()]
    assert drawn == [[[0, 0], [1, 0], [1, 1]], [[0, 1], [0, 0]]]
    assert dots.get_offsets().tolist() == points.tolist()


def test_qualitative_prints_each_score_and_marks_the_best():
    rng = np.random.default_rng(0)
    faces = np.stack([random_face(rng)])
    predictions = {"ours": faces, "linear": faces}
    scores = {"ours": np.array([1.42e-4]), "linear": np.array([3e-6])}
    figure = qualitative(
        faces[..., :2], faces[..., :2], faces, predictions, SCHEME, ["Frontal"], scores
    )
    weights = {text.get_text(): text.get_weight() for text in figure.axes[0].texts}
    assert weights["1.42"] == "normal"
    assert weights["0.0300"] == "bold"
    assert "Frontal" in weights


def test_a_face_that_a_method_did_not_find_is_marked():
    rng = np.random.default_rng(0)
    faces = np.stack([random_face(rng)])
    predictions = {"ours": faces, "mediapipe": np.full_like(faces, np.nan)}
    scores = {"ours": np.array([1.42e-4]), "mediapipe": np.array([np.nan])}
    photos = Photos(np.zeros((1, 20, 20, 3), np.uint8), rng.uniform(0, 20, (1, 72, 2)))
    figure = qualitative(
        faces[..., :2], faces[..., :2], faces, predictions, SCHEME, ["Frontal"], scores, photos
    )
    written = texts(figure.axes[0])
    assert written.count("N/A") == 2  # from the front and the side
    assert "nan" not in written
    weights = {text.get_text(): text.get_weight() for text in figure.axes[0].texts}
    assert weights["1.42"] == "bold"
    assert len(figure.axes[0].images) == 1


def test_landmarks_lie_on_the_photo_where_they_were_found():
    rng = np.random.default_rng(0)
    faces = np.stack([random_face(rng)])
    corners = np.zeros((1, 72, 2))
    corners[0, 1] = (20, 0)
    photos = Photos(np.zeros((1, 20, 20, 3), np.uint8), corners)
    figure = qualitative(faces[..., :2], faces[..., :2], faces, {}, SCHEME, ["Frontal"], {}, photos)
    left, right, _, top = figure.axes[0].images[0].get_extent()
    dots = next(c for c in figure.axes[0].collections if len(c.get_offsets()) > 1).get_offsets()
    np.testing.assert_allclose(dots[:2], [[left, top], [right, top]])


def test_error_of_the_found_truth_is_its_distance_from_the_true_one():
    rng = np.random.default_rng(0)
    truth = rng.normal(0, 30, (40, 51, 3))
    found = truth + [3.0, 0.0, 4.0]
    example = Example(np.zeros((8, 8, 3), np.uint8), truth[0, :, :2], truth[0], *truth[:2], None)
    figure = ground_truth([example], IBUG, found, truth)
    shares = next(axes for axes in figure.axes if "share" in axes.get_ylabel())
    for line in shares.lines:
        np.testing.assert_allclose(line.get_xdata(), 5.0)
    unknown = ground_truth([example], IBUG, found, None)
    assert not any("share" in axes.get_ylabel() for axes in unknown.axes)


def test_truth_lies_beneath_a_frontal_view_normalised_by_itself():
    rng = np.random.default_rng(0)
    faces = np.stack([random_face(rng)])
    figure = qualitative(
        faces[..., :2], 1.7 * faces[..., :2] + (3, -2), faces, {}, SCHEME, ["Frontal"], {}
    )
    beneath, above = (
        c.get_offsets() for c in figure.axes[0].collections[2:6] if len(c.get_offsets()) > 1
    )
    np.testing.assert_allclose(beneath, above, atol=1e-12)


def test_confidence_band_of_a_constant_error_has_no_width():
    errors = pose_errors(np.random.default_rng(0)).assign(mse=2e-4)
    _, yaws, _ = error_per_pose(errors).axes
    np.testing.assert_allclose(yaws.lines[0].get_ydata()[0], 2e-4)
    for band in yaws.collections:
        corners = np.concatenate([path.vertices for path in band.get_paths()])
        np.testing.assert_allclose(corners[:, 1], 2e-4)


def test_region_errors_are_root_mean_squares():
    errors = {"ours": np.full(N_LANDMARKS, 3.0), "linear": np.full(N_LANDMARKS, 2.0)}
    figure = error_per_landmark(errors, SCHEME, random_face(np.random.default_rng(0)))
    regions = next(axes for axes in figure.axes if axes.get_xlabel())
    assert len(regions.get_yticks()) == len(set(SCHEME.groups))
    for line, expected in zip(regions.lines, (3.0, 2.0), strict=False):
        np.testing.assert_allclose(line.get_xdata(), expected)


def test_lag_is_drawn_as_root_mean_square_error_by_epoch():
    constant, _ = draw_lag(None).axes
    inference, train, anew = constant.lines[:3]
    np.testing.assert_allclose(inference.get_xydata(), [[1, 0.03], [2, 0.02]])
    np.testing.assert_allclose(train.get_ydata(), np.sqrt(RECORD["train"]))
    np.testing.assert_allclose(anew.get_xydata(), [[2, 0.004]])


def test_summary_writes_both_numbers_and_a_dash_where_there_is_none():
    figure = summary(headline_table(), "bfm")
    mse = texts(figure.axes[1])
    depth = texts(figure.axes[3])
    assert mse == [
        *("this work", "0.0300 ± 0.0010", "1.500 ± 0.020", "–"),
        *("published", "–", "1.4 ± 0.005", "0.6 ± 0.004"),
    ]
    assert depth[2] == "71.9400 ± 0.0020"


@pytest.mark.slow
@pytest.mark.skipif(not OPEN_HEAD.exists(), reason="the open head is not in ../shared")
def test_eleven_methods_on_real_faces_fit_into_300_kilobytes(tmp_path):
    rng = np.random.default_rng(0)
    with np.load(OPEN_HEAD, allow_pickle=False) as head:
        mean = head["mean"][head["L72"]]
        basis = head["id_basis"][:, head["L72"]].astype(float)
    shapes = mean + np.tensordot(rng.standard_normal((4, len(basis))), basis, axes=1)
    figure = draw_qualitative(shapes / 207, PAPER_METHODS, rng)
    png, _ = style.save(figure, tmp_path, "qualitative")
    assert png.stat().st_size < 300_000


def rendered():
    model = load_openhead()
    faces = make_dataset(model, 24, np.random.default_rng(0))
    scene = make_scene(model, "bfm72", 96)
    return render(scene, faces, range(24), np.random.default_rng(0))


@pytest.mark.slow
def test_contact_sheet_of_real_renders_is_small_and_has_their_landmarks(apart, tmp_path):
    images, landmarks = apart(rendered)
    figure = renders(images, landmarks, SCHEME)
    assert len(figure.axes) == 24
    assert not figure.axes[11].lines
    assert np.array_equal(figure.axes[12].lines[-1].get_xydata(), landmarks[12])
    assert np.array_equal(figure.axes[23].images[0].get_array(), images[23])
    for path in style.save(figure, tmp_path, "renders"):
        assert path.stat().st_size < 300_000, path
