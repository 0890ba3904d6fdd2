"""Laws of the figures: they show the data, in stated units, in small files of equal bytes."""

import itertools

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_rgb

from data_gen.models.openhead import load_openhead
from deepmds_keras.errors import InputError
from deepmds_keras.landmarks import load_scheme
from experiments.figures import errors, style
from experiments.figures.curves import batchnorm_lag, learning_curves
from experiments.figures.ground_truth import fits, ground_truth
from experiments.figures.qualitative import gallery, qualitative, renders
from experiments.figures.summary import errors_by_seed, summary
from experiments.figures.wireframe import draw_wireframe, front_view, side_view
from experiments.lifting import component_ablation
from experiments.methods import METHODS
from experiments.presets import PRESETS
from experiments.scoring.scores import Scores

HEAD, BFM72, IBUG51 = load_openhead(), load_scheme("bfm72"), load_scheme("ibug51")
DRAWN = [method.id for method in METHODS.values() if method.drawn]
PICTURED = [m for m in DRAWN if METHODS[m].pictured and "flame" in METHODS[m].tracks]
RECORD = {"train": [2e-1, 1e-1, 2e-4, 1e-4], "inference": [9e-1, 8e-1, 9e-4, 4e-4]}


def faces(rng, n=2, scheme="bfm72"):
    mean = HEAD.mean[HEAD.landmarks[scheme]]
    return mean + rng.normal(0, 2, (n, *mean.shape))


def draw_learning(rng):
    histories = {"deep_mds": {"autoencoder": RECORD, "dissimilarity_net": RECORD}}
    return learning_curves(histories, {m: {"train": [9.0, 2.0]} for m in ("mobileface", "ringnet")})


def draw_lag(rng):
    record = RECORD | {"reestimated": 1.6e-5}
    return batchnorm_lag({"constant": {0: record, 1: record}, "cosine": {0: record}})


def face_errors(rng, n=60):
    perspective = np.arange(n) % 2 == 1
    return pd.DataFrame(
        {
            "method": np.repeat(["deep_mds", "ridge"], n // 2),
            "projection": np.where(perspective, "perspective", "orthographic"),
            "yaw": np.where(perspective, -rng.uniform(0, 45, n), rng.choice([-45, 0, 45], n)),
            "pitch": np.where(perspective, -rng.uniform(0, 30, n), 0),
            "mse": rng.uniform(1e-5, 1e-3, n),
        }
    )


def draw_gallery(rng):
    shapes = faces(rng, 2, "ibug51")
    lost = np.stack([shapes[0], np.full((51, 3), np.nan)])
    photos = np.zeros((2, 8, 8, 3), np.uint8), np.zeros((2, 51, 2))
    names = ["left", "right"]
    return gallery(*photos, {"deep_mds": shapes, "mediapipe": lost}, names, IBUG51)


def scans(rng, n=6):
    truth = faces(rng, n, "ibug51")
    found = truth + rng.normal(0, 1, truth.shape)
    table = {"truth": truth, "landmarks": found + [3.0, 0, 4], "fitted": truth + 1}
    return table | {"example_points": rng.normal(0, 40, (2, 500, 3))}


def draw_ground_truth(rng, **table):
    images, pixels = np.zeros((2, 32, 32, 3), np.uint8), rng.uniform(0, 32, (2, 51, 2))
    return ground_truth(table or scans(rng), np.arange(2), images, pixels, IBUG51)


def draw_fits(rng):
    pixels, images = rng.uniform(0, 32, (2, 72, 2)), np.zeros((2, 32, 32, 3), np.uint8)
    distances = {"model_fit": rng.gamma(9, 1, 99), "mean_shape": rng.gamma(8, 1, 99)}
    return fits(images, pixels[:, :68], pixels, BFM72, distances)


def seed_metrics(rng):
    runs = {
        "method": ["deep_mds", "deep_mds", "ridge", "ridge"],
        "seed": [3, 4] * 2,
        "metric": "mse",
    }
    return pd.DataFrame(runs | {"value": rng.uniform(1e-4, 1e-3, 4)})


def draw_ablation(rng):
    rows = [
        {"step": step, "embedding": name, "mse": 1e-5, "low": 9e-6, "high": 2e-5}
        for step in component_ablation.STEPS
        for name in component_ablation.EMBEDDINGS
    ]
    return component_ablation.draw(pd.DataFrame(rows))


def headline_table():
    columns = ["method", "metric", "mean", "std", "paper_mean", "median", "lowest", "highest"]
    nan = np.nan
    rows = [
        ("ridge", "mse", 3e-6, 1e-7, nan, nan, nan, nan),
        ("ridge", "depth_corr", 71.999, 1e-4, 72.5, nan, nan, nan),
        ("deep_mds", "mse", 9e-4, 2e-6, 1.4e-4, 1.5e-4, 1e-4, 3e-4),
        ("deep_mds", "depth_corr", 71.94, 0.002, 71.95, 71.9, 71.8, 71.95),
        ("mobileface", "mse", nan, nan, 6e-5, nan, nan, nan),
    ]
    return pd.DataFrame(rows, columns=columns).assign(n_seeds=10)


def draw_qualitative(rng, methods=("deep_mds", "ridge"), n=1, detected=True, photos=None):
    truth = faces(rng, n) / 200
    predictions = {method: truth + rng.normal(0, 0.01, truth.shape) for method in methods}
    predictions[methods[-1]][0] += 0 if detected else np.nan
    scores = {m: Scores(p, truth, np.full(n, 200.0), np.zeros(n)) for m, p in predictions.items()}
    frontal, names = 1.7 * truth[..., :2] + (3, -2), [f"View {row}" for row in range(n)]
    views = truth @ [[0.7, 0], [0, 1], [-0.7, 0]]
    return qualitative(views, frontal, scores, np.arange(n), names, BFM72, photos)


PLOTS = {
    "learning_curves": draw_learning,
    "batchnorm_lag": draw_lag,
    "error_per_landmark": lambda rng: errors.error_per_landmark(
        {method: rng.uniform(1, 9, 72) for method in DRAWN}, BFM72, faces(rng)[0], DRAWN[:3]
    ),
    "error_per_pose": lambda rng: errors.error_per_pose(face_errors(rng)),
    "errors": lambda rng: errors.error_distribution({"deep_mds": rng.uniform(1e-5, 1e-3, 50)}),
    "qualitative": lambda rng: draw_qualitative(rng, PICTURED, 4),
    "scans": draw_ground_truth,
    "fits": draw_fits,
    "errors_by_seed": lambda rng: errors_by_seed(seed_metrics(rng)),
    "summary": lambda rng: summary(headline_table(), 72),
    "gallery": draw_gallery,
    "component_ablation": draw_ablation,
}


def texts_of(axes):
    """Title and texts of axes, and what stands below them."""
    seen = [axes.title, *axes.texts]
    if axes.axison:
        low, high = axes.get_xlim()
        ticks = [text for text in axes.get_xticklabels() if low <= text.get_position()[0] <= high]
        seen += [axes.xaxis.label, *ticks]
    return [text for text in seen if text.get_text()]


@pytest.mark.parametrize("preset", PRESETS.values(), ids=PRESETS)
def test_figures_of_a_small_preset_are_stamped_wherever_they_lie(preset, tmp_path):
    figure = draw_learning(None)
    style.save(figure, tmp_path / "smoke" / "figures", "curves", preset.caution)
    stamps = [text.get_text() for text in figure.texts]
    assert stamps == ([] if preset.name == "full" else [preset.caution])


@pytest.mark.parametrize("draw", PLOTS.values(), ids=PLOTS)
def test_figures_fit_a_page_and_neither_stamp_nor_legend_covers_anything(draw, tmp_path):
    figure = draw(np.random.default_rng(0))
    assert figure.get_figwidth() <= 7.2
    style.save(figure, tmp_path, "figure", "too small a run")
    stamp = next(text for text in figure.texts if text.get_text() == "too small a run")
    assert stamp.get_window_extent().x0 >= figure.bbox.x1
    for legend in figure.legends:
        box = legend.get_window_extent()
        assert box.x0 >= 0 and box.x1 <= figure.bbox.x1
    boxes = {t: t.get_window_extent() for axes in figure.axes for t in texts_of(axes)}
    for text, box in boxes.items():
        assert box.x0 > -0.5 and box.x1 < figure.bbox.x1 + 0.5, text.get_text()
    for (first, a), (second, b) in itertools.combinations(boxes.items(), 2):
        shared = np.minimum(a.max, b.max) - np.maximum(a.min, b.min)
        assert (shared < 0.5).any(), (first.get_text(), second.get_text())


# Machado, Oliveira and Fernandes (2009), severity 1, in linear RGB.
SIGHTS = {
    "normal": np.eye(3),
    "protanopia": np.array([[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
                            [-0.003882, -0.048116, 1.051998]]),
    "deuteranopia": np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                              [-0.011820, 0.042940, 0.968881]]),
}  # fmt: skip
TO_XYZ = np.array([[0.4339, 0.3762, 0.1899], [0.2127, 0.7152, 0.0721], [0.0178, 0.1095, 0.8727]])


def lab(colour, sight):
    """CIELAB of an sRGB colour as it is seen, with white at (100, 0, 0)."""
    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    xyz = TO_XYZ @ (SIGHTS[sight] @ linear).clip(0, 1)
    x, y, z = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


@pytest.mark.parametrize("sight", SIGHTS)
def test_methods_of_a_figure_differ_in_marker_and_to_all_readers_in_colour(sight):
    for first, second in itertools.combinations(METHODS.values(), 2):
        assert (first.marker, first.colour) != (second.marker, second.colour)
        if first.drawn and second.drawn and {*first.tracks} & {*second.tracks}:
            if {first.id, second.id} == {"ringnet", "ringnet_licensed"}:
                continue  # only one of them is in a run
            apart = np.linalg.norm(lab(first.colour, sight) - lab(second.colour, sight))
            assert first.marker != second.marker and apart > 14, (first.id, second.id, apart)
    for method in (method for method in METHODS.values() if method.drawn):
        apart = np.linalg.norm(lab(method.colour, sight) - lab(style.TRUTH_COLOUR, sight))
        assert apart > 14, method.id


@pytest.mark.slow
@pytest.mark.parametrize("name", PLOTS)
def test_equal_inputs_give_equal_bytes(name, tmp_path):
    for folder in ("first", "second"):
        style.save(PLOTS[name](np.random.default_rng(0)), tmp_path / folder, name)
    files = sorted((tmp_path / "first").iterdir())
    assert [path.name for path in files] == [f"{name}.pdf", f"{name}.png"]
    for path in files:
        content = path.read_bytes()
        assert content == (tmp_path / "second" / path.name).read_bytes()
        assert b"CreationDate" not in content and (path.suffix == ".pdf" or len(content) < 300_000)


@pytest.mark.parametrize("draw", PLOTS.values(), ids=PLOTS)
def test_every_quantity_on_a_value_axis_has_its_unit(draw):
    units = ("(mm)", "(mm²)", "(%)", "units)", "(°)", "epochs)", "(no unit)", "faces", "andmarks)")
    for axes in draw(np.random.default_rng(0)).axes:
        for label in filter(None, (axes.get_xlabel(), axes.get_ylabel())):
            assert not axes.axison or any(unit in label for unit in units), label


def test_lines_are_means_in_the_unit_with_their_intervals():
    rows = pd.DataFrame({"method": ["deep_mds", "ridge"] * 2, "x": [2.0, 2.0, 1.0, 1.0]})
    rows = rows.assign(mean=[4e-4, 1e-4] * 2, sem=[1e-5, np.nan] * 2)
    ends = rows.assign(low=rows["mean"] / 2, high=rows["mean"] * 3)
    panels = [errors.Panel(rows, "x", "Noise (mm)"), errors.Panel(ends, "x", shaded=(0, 1))]
    figure = errors.error_lines(panels)
    for axes, (low, high) in zip(figure.axes, [(3.804, 4.196), (2, 12)], strict=True):
        line, band = axes.lines[0], axes.collections[0].get_paths()[0].vertices
        np.testing.assert_allclose(line.get_xydata(), [[1, 4], [2, 4]])
        np.testing.assert_allclose([band[:, 1].min(), band[:, 1].max()], [low, high])
        assert line.get_color() == style.look("deep_mds").colour
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    interval = "95 % interval over faces"
    assert labels == ["Deep-MDS", "Ridge regression", interval, "training views"]
    other = [errors.Panel(rows.assign(method="somebody"), "x")]
    with pytest.raises(InputError, match="somebody"):
        errors.error_lines(other)
    drawn = errors.error_lines(other, looks={"somebody": style.Look("Somebody", "#123456", "o")})
    assert drawn.axes[0].lines[0].get_color() == "#123456"


def test_errors_by_pose_are_means_of_the_faces_in_it():
    table = face_errors(np.random.default_rng(0), 600)
    kinds = errors.error_per_pose(table).axes[0]
    ours = table[table["method"] == "deep_mds"].groupby(["projection", "yaw"])["mse"].mean() / 1e-4
    drawn = kinds.containers[0].lines[0].get_xydata()[:, 1]
    np.testing.assert_allclose(drawn[:3], ours["orthographic"])
    assert [text.get_text() for text in kinds.get_xticklabels()][:3] == [
        f"orth.\n{yaw}°" for yaw in ("−45", "0", "45")
    ]
    for axes in errors.error_per_pose(table.assign(mse=2e-4)).axes[1:]:
        assert len(axes.lines) == len(axes.collections) == 2
        for band in axes.collections:
            np.testing.assert_allclose(band.get_paths()[0].vertices[:, 1], 2)


def test_region_errors_are_root_mean_squares():
    squares = np.where(np.arange(72) % 2, 16.0, 2.0)
    groups = pd.Series(squares).groupby(np.array(BFM72.groups)).mean()
    figure = errors.error_per_landmark(
        {"deep_mds": np.sqrt(squares)}, BFM72, faces(np.random)[0], ["deep_mds"]
    )
    regions = next(axes for axes in figure.axes if "Region" in axes.get_xlabel())
    drawn = regions.containers[0].lines[0].get_xydata()[:, 1]
    names = [label.get_text().split("\n(")[0] for label in regions.get_xticklabels()]
    expected = [groups[name.replace("\n", "_")] for name in names]
    np.testing.assert_allclose(drawn, np.sqrt(expected))
    for part in ("brow", "eye"):  # in the face's order, both sides next to each other
        assert names.index(f"left\n{part}") == names.index(f"right\n{part}") + 1
    assert names[0] == "right\nbrow" and names[-1] == "chin"


def test_curves_are_the_losses_by_epoch_and_leave_out_the_first_of_training():
    train, _ = draw_learning(None).axes[0].lines
    np.testing.assert_allclose(train.get_xydata(), [[3, 2], [4, 1]])
    inference, _, again = draw_lag(None).axes[0].lines
    np.testing.assert_allclose(inference.get_ydata(), np.sqrt(RECORD["inference"]))
    np.testing.assert_allclose(again.get_xydata(), [[4, 0.004]])


def test_summary_draws_the_median_over_seeds_and_what_the_depth_correlation_lacks():
    drawn = [np.concatenate([line.get_xdata() for line in axes.lines])
             for axes in summary(headline_table(), 72).axes]  # fmt: skip
    for axes, expected in zip(drawn, ([0.03, 1.4, 1.5, 1, 3], [0.001, 0.05, 0.1]), strict=True):
        assert all(np.isclose(axes, value).any() for value in expected)
        assert not np.nanmin(axes) < 0  # the paper's impossible value
    assert not np.isclose(drawn[0], 9).any()  # the mean of one seed


def test_summary_says_what_was_not_run_and_what_cannot_be_drawn():
    left, right = summary(headline_table(), 72).axes
    for axes in (left, right):
        ((place, text),) = [(text.get_position()[1], text.get_text()) for text in axes.texts]
        assert text == "not run" and left.get_yticklabels()[int(place)].get_text() == "MobileFace"
    assert "above 72: not drawn" in right.get_xlabel() and "drawn" not in left.get_xlabel()


def test_markers_without_lines_have_none_in_the_legend():
    rows = pd.DataFrame({"method": ["deep_mds", "ridge"] * 2, "x": list("aabb"), "mean": 1e-4})
    (legend,) = errors.error_lines([errors.Panel(rows, "x")]).legends
    assert [line.get_ls() for line in legend.get_lines()] == ["None", "None"]


def test_every_seed_is_a_dot_above_its_median():
    metrics = seed_metrics(np.random.default_rng(0))
    (axes,) = errors_by_seed(metrics).axes
    dots = np.concatenate([line.get_ydata() for line in axes.lines if line.get_ls() == "None"])
    np.testing.assert_allclose(dots, metrics["value"] / 1e-4)
    medians = metrics.groupby("method", sort=False)["value"].median() / 1e-4
    for label, median in zip(axes.get_xticklabels(), medians, strict=True):
        assert f"{median:.3g}" in label.get_text()


def test_conventions_of_the_views():
    left_ear, right_ear = front_view(np.array([[60.0, 0, 0], [-60.0, 0, 0]]))
    assert left_ear[0] > right_ear[0]  # the viewer faces the subject
    nose_tip, brow, ear = side_view(np.array([[0.0, 0, 130], [0, 40, 110], [60, 10, 20]]))
    assert nose_tip[0] > brow[0] > ear[0] and brow[1] > nose_tip[1]


def test_wireframe_joins_the_landmarks_of_each_polyline():
    axes = style.Figure().add_subplot()
    points = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    draw_wireframe(axes, points, ((0, 1, 2), (3, 0)), colour="black")
    lines, dots = axes.collections
    drawn = [line.tolist() for line in lines.get_segments()]
    assert drawn == [[[0, 0], [1, 0], [1, 1]], [[0, 1], [0, 0]]]
    assert dots.get_offsets().tolist() == points.tolist()


def test_qualitative_shows_the_best_score_and_what_was_not_found():
    photos = np.zeros((2, 20, 20, 3), np.uint8), np.resize([(0, 0), (20, 0)], (2, 72, 2))
    methods = ("deep_mds", "ridge", "mediapipe")
    figure = draw_qualitative(np.random.default_rng(0), methods, 2, False, photos)
    photo, frontal, _, *others = figure.axes[:6]
    texts = [text for axes in others for text in axes.texts if text.get_text()[0].isdigit()]
    scores = {float(text.get_text()): text.get_weight() for text in texts}
    assert scores == {min(scores): "bold", max(scores): "normal"}
    assert [text.get_text() for axes in others for text in axes.texts].count("N/A") == 1
    left, right, _, top = photo.images[0].get_extent()
    np.testing.assert_allclose(photo.collections[0].get_offsets()[:2], [[left, top], [right, top]])
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["ground truth"]
    (grey,) = figure.legends[0].get_lines()
    assert grey.get_color() == style.TRUTH_COLOUR
    # The truth lies beneath a frontal view that is normalised by itself.
    truth, drawn = (frontal.collections[k].get_offsets() for k in (1, 3))
    np.testing.assert_allclose(drawn, truth, atol=1e-12)


def test_no_face_is_cut_off():
    rng = np.random.default_rng(0)
    wild, truth = faces(rng, 1) / 200 * (1, 1.3, 1.2), faces(rng, 1) / 200
    scores = {"deep_mds": Scores(wild, truth, np.full(1, 200.0), np.zeros(1))}
    figure = qualitative(truth[..., :2], truth[..., :2], scores, np.arange(1), ["view"], BFM72)
    for axes in figure.axes:
        (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
        for dots in axes.collections[1::2]:
            x, y = np.array(dots.get_offsets()).T
            assert left < x.min() and x.max() < right and bottom < y.min() and y.max() < top


def test_gallery_marks_what_was_not_found():
    axes = np.array(draw_gallery(np.random.default_rng(0)).axes, object).reshape(2, 3)
    photos, others = axes[:, 0], axes[:, 1:]
    assert [axes.texts[0].get_text() for axes in photos.ravel()] == ["left", "right"]
    assert [len(axes.texts) for axes in others.ravel()] == [0, 0, 0, 1]


def test_error_of_the_found_truth_is_its_distance_from_the_true_one_whatever_the_pose():
    rng = np.random.default_rng(0)
    table = scans(rng)
    shares = next(a for a in draw_ground_truth(rng, **table).axes if "Share" in a.get_ylabel())
    for line in shares.lines:
        middle = line.get_xdata()[250]
        assert 1.4 < middle < 1.7, "of three coordinates with an s.d. of 1 mm, moved by 5 mm"
    del table["truth"]
    assert len(draw_ground_truth(rng, **table).axes) == 6


def test_contact_sheet_has_landmarks_in_its_lower_half():
    rng = np.random.default_rng(0)
    images, landmarks = rng.integers(0, 255, (24, 9, 9, 3), np.uint8), rng.random((24, 72, 2))
    figure = renders(images, landmarks, BFM72)
    assert not figure.axes[11].collections
    assert np.array_equal(figure.axes[12].collections[-1].get_offsets(), landmarks[12])
    assert np.array_equal(figure.axes[23].images[0].get_array(), images[23])
