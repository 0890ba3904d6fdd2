"""The compared ways do the same; times, ratios and memory are what they are said to be."""

import math
import time

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.distance import pdist

from data_gen.datasets.dataset import make_dataset
from data_gen.models.registry import load_model
from deepmds_keras import proximities
from deepmds_keras.embedding import embed
from experiments.bench import agreement
from experiments.bench import released_code as released
from experiments.bench.measurements import SEVERAL_JOBS, Implementation, measure, table_of
from experiments.bench.memory import peak_memory_mb

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def model():
    return load_model("openhead")


@pytest.fixture(scope="module")
def networks():
    from deepmds_keras.pipeline import DeepMDS

    return DeepMDS.pretrained("deepmds-bfm72")


@pytest.fixture(scope="module")
def views(model):
    return make_dataset(model, 3, np.random.default_rng(0)).views


@pytest.mark.parametrize("protocol", ["paper", "released"])
def test_faces_made_one_by_one_are_those_made_together(model, protocol):
    together = make_dataset(model, 8, np.random.default_rng(1), protocol=protocol)
    for k, identity in enumerate(together.identity):
        camera = together.cameras[k : k + 1]
        landmarks, view = released.face(model, identity, camera, "bfm72")
        np.testing.assert_allclose(landmarks, together.landmarks[k], atol=1e-4)
        np.testing.assert_allclose(view, together.views[k], atol=1e-4)


def test_faces_made_one_by_one_are_random_and_of_the_protocol(model):
    landmarks, views = released.make_faces(
        model, 40, np.random.default_rng(2), "bfm72", protocol="released"
    )
    frontal = np.isclose(views, landmarks[..., :2]).all((1, 2))
    assert 0.2 < frontal.mean() < 0.8, "40 %, and a third of the 30 % that are turned by yaw"
    assert landmarks.std(0).min() > 0.1, "millimetres"


@pytest.mark.parametrize("variant", proximities.VARIANTS)
def test_loops_over_pairs_give_the_pair_features(views, variant):
    ours = proximities.pair_features(views[0], variant)
    n_landmarks = len(views[0])
    pairs = released.all_pairs(n_landmarks)
    assert len(pairs) == n_landmarks**2
    square = released.pair_features(views[0], variant, pairs).reshape(n_landmarks, n_landmarks, -1)
    first, second = np.triu_indices(n_landmarks, 1)
    np.testing.assert_allclose(square[first, second], ours, rtol=1e-6)
    np.testing.assert_array_equal(square, square.swapaxes(0, 1))


def test_loops_over_pairs_give_the_distances(model):
    shape = model.mean[:9]
    distances = released.pair_distances(shape, zip(*np.triu_indices(9, 1), strict=True))
    np.testing.assert_allclose(distances.ravel(), pdist(shape), rtol=1e-6)


@pytest.mark.parametrize("loops", [False, True])
def test_one_predict_a_face_gives_the_dissimilarities_of_all(networks, views, loops):
    frontal, matrices = released.predict(networks, views[:2], loops=loops)
    np.testing.assert_allclose(frontal, networks.frontalise(views[:2]), atol=1e-6)
    np.testing.assert_allclose(matrices, networks.dissimilarities(views[:2]), atol=1e-5)


def test_four_random_starts_find_the_points_of_exact_distances(model):
    shape = model.mean[model.landmarks["ibug51"]]
    distances = np.linalg.norm(shape[:, None] - shape, axis=-1)
    (points,) = released.embed(distances)
    correlation = np.corrcoef(pdist(points), pdist(shape))[0, 1]
    assert correlation > 0.99


@pytest.fixture(scope="module")
def matrices():
    from experiments.bench.growth import dissimilarities

    def network(features, training):
        return -np.sqrt(np.abs(features).sum(1, keepdims=True))

    return dissimilarities(network, np.random.default_rng(3).random((3, 24, 2)), "paper")


def test_dissimilarities_of_any_number_of_landmarks_are_those_of_each_pair(matrices):
    views = np.random.default_rng(3).random((3, 24, 2))
    first, second = np.triu_indices(24, 1)
    for own, view in zip(matrices, views, strict=True):
        view = (view - view.min()) / np.ptp(view)
        difference = np.abs(view[first] - view[second])
        features = np.abs(view[first] * view[second]), difference, np.exp(-difference)
        expected = np.sqrt(np.sum(features, axis=(0, 2)))
        np.testing.assert_allclose(own[first, second], expected, rtol=1e-5)
    assert (matrices == np.swapaxes(matrices, 1, 2)).all()


def test_agreement_is_that_of_the_solvers(matrices):
    found = agreement.compare(matrices)
    assert found["n_faces"] == 3
    assert found["largest_stress_difference"] < 1e-6
    assert found["largest_shape_difference"] < 1e-6
    assert found["times_sklearn"] > 0


def test_agreement_sees_a_solver_that_goes_wrong(matrices, monkeypatch):
    def wrong(matrices, *, solver, return_stress):
        shapes, stress = embed(matrices, solver="sklearn", return_stress=True)
        if solver == "batched":
            shapes[-1, 0] += 0.1 * np.linalg.norm(shapes[-1])
            stress[0] *= 1.01
        return shapes, stress

    monkeypatch.setattr(agreement, "embed", wrong)
    found = agreement.compare(matrices)
    assert found["largest_stress_difference"] == pytest.approx(0.01)
    assert 0.01 < found["largest_shape_difference"] < 0.2


def test_every_row_has_as_many_faces_as_it_says(model, networks, views, matrices):
    from experiments.bench.parts import end_to_end
    from experiments.bench.workload import Workload, embed_all

    workload = Workload(None, model, networks, views, views, matrices)
    assert len(end_to_end(workload, 5, "batched")) == 5, "more than there are views"
    np.testing.assert_array_equal(workload.first_views(5)[3:], views[:2])
    assert sum(map(len, embed_all(matrices, 5, "batched"))) == 5, "more than there are matrices"


def test_only_trained_runs_are_compared(tmp_path):
    from experiments.presets import SMOKE
    from experiments.run import Run

    run = Run("openhead", SMOKE, build=tmp_path)
    assert agreement.trained_runs(run) == []
    for name in ("bfm-smoke-paper-seed0/test.npz", "celeba-smoke-paper-seed0/test.npz"):
        path = tmp_path / "ict" / name
        path.parent.mkdir(parents=True)
        path.touch()
    assert agreement.trained_runs(run) == [], "no networks"
    (tmp_path / "ict" / "bfm-smoke-paper-seed0" / "networks.json").touch()
    found = [(own.model, own.track) for own in agreement.trained_runs(run)]
    assert found == [("ict", "bfm"), ("ict", "celeba")], "photos are seen by the BFM track's"


def test_memory_gauge_sees_what_a_call_allocates():
    assert 90 < peak_memory_mb(lambda: np.ones(100_000_000, np.uint8)) < 115


def test_memory_gauge_does_not_see_what_was_freed_before():
    np.ones(300_000_000, np.uint8)
    small = [bytearray(2000) for _ in range(50_000)]  # of the heap, not pages of their own
    del small
    assert peak_memory_mb(lambda: None) < 10


def test_memory_gauge_sees_what_is_allocated_anew_after_it_was_freed():
    def allocate():
        return [bytearray(2000) for _ in range(50_000)]

    allocate()
    assert peak_memory_mb(allocate) > 80


def test_without_a_gauge_the_call_is_made_and_the_row_says_why(monkeypatch):
    from experiments.bench import memory

    monkeypatch.setattr(memory, "_PROCESS", memory.Path("/nowhere"))
    calls = []
    assert math.isnan(peak_memory_mb(lambda: calls.append(1)))
    assert calls == [1]
    (row,) = measure("", [Implementation("embedding", "ours", lambda: None, 72, 1)], 0)
    assert math.isnan(row["peak_memory_mb"])
    assert row["note"] == memory.NO_GAUGE


def ways_of(*calls, jobs=1):
    names = ("released", "sklearn", "ours")
    return [
        Implementation("embedding", name, call, 72, 10, jobs)
        for name, call in zip(names, calls, strict=False)
    ]


def test_ways_are_timed_in_turn_after_a_first_pass():
    order = []
    ways = ways_of(lambda: order.append("a"), lambda: order.append("b"))
    measure("", ways, 2)
    assert "".join(order) == "abab" + "ab"


def test_time_is_the_median_of_the_later_passes():
    pauses = iter([0.4, 0.0, 0.1, 0.4])
    (row,) = measure("", ways_of(lambda: time.sleep(next(pauses))), 3)
    assert 0.1 <= row["seconds"] < 0.4, "the median of 0, 0.1 and 0.4"
    pauses = iter([0.1])
    (row,) = measure("", ways_of(lambda: time.sleep(next(pauses))), 0)
    assert row["seconds"] >= 0.1, "the first pass is all there is"


def test_what_takes_long_is_timed_once(monkeypatch):
    from experiments.bench import measurements

    monkeypatch.setattr(measurements, "_LONG", 0.05)
    calls = []
    quick, slow = ways_of(lambda: calls.append("q"), lambda: [calls.append("s"), time.sleep(0.1)])
    rows = measure("", [quick, slow], 3)
    assert calls.count("q") == 4
    assert calls.count("s") == 1
    assert rows[1]["seconds"] >= 0.1


def test_what_would_take_too_long_is_a_row_without_a_time():
    before = [row("released", 1000.0, n_faces=20), row("sklearn", 1.0, n_faces=100)]
    first, second = measure("", ways_of(lambda: 1 / 0, lambda: None), 0, before)
    assert math.isnan(first["seconds"])
    assert first["note"] == "not run: about 8 min, by the row of fewer faces"
    assert second["seconds"] >= 0


def test_what_cannot_be_done_is_a_row_that_says_why():
    (absent,) = measure("", [Implementation("embedding", "ours", None, 72, 10, note="no numba")], 3)
    assert math.isnan(absent["seconds"])
    assert absent["note"] == "no numba"


def test_rows_of_several_processes_say_so():
    (alone,) = measure("", ways_of(lambda: None, jobs=2), 0)
    assert alone["note"] == SEVERAL_JOBS


def row(way, seconds, n_faces=10, comparison="parts", jobs=1, n_landmarks=72, part="embedding"):
    return {
        "comparison": comparison, "part": part, "way": way, "n_landmarks": n_landmarks,
        "n_faces": n_faces, "jobs": jobs, "seconds": seconds, "peak_memory_mb": 1.0, "note": "",
    }  # fmt: skip


def test_ratios_are_those_of_faces_in_a_second():
    rows = [row("released", 8.0, 4), row("sklearn", 3.0, 30), row("batched", 1.0, 100)]
    table = table_of([*rows, row("lifting", 1.0, 1000)])
    assert table["ms_per_face"].tolist() == [2000, 100, 10, 1]
    assert table["times_released"].tolist() == [1, 20, 200, 2000]
    assert table["times_sklearn"].tolist() == [0.05, 1, 10, 100]
    assert table["times_batched"].tolist() == [0.005, 0.1, 1, 10]


def test_ratios_are_between_as_many_landmarks_processes_and_the_same_part():
    table = table_of(
        [
            row("released", 10.0),
            row("ours", 1.0, n_landmarks=51),
            row("ours", 1.0, jobs=2),
            row("ours", 1.0, part="prediction"),
            row("ours", 1.0),
        ]
    )
    times = table["times_released"]
    assert times.isna().tolist() == [False, True, True, True, False]
    assert times.iloc[-1] == 10


def test_ratios_are_within_a_comparison_and_between_the_nearest_numbers_of_faces():
    rows = [
        row("sklearn", 20.0),
        row("sklearn", 30.0, comparison="faces"),
        row("sklearn", 400.0, 100, comparison="faces"),
        row("sklearn", math.nan, 1000, comparison="faces"),
        row("batched", 1.0),
        row("batched", 1.0, comparison="faces"),
        row("batched", 10.0, 1000, comparison="faces"),
        row("batched", 1.0, comparison="jobs"),
    ]
    times = table_of(rows)["times_sklearn"]
    assert times.tolist()[4:7] == [20, 30, 400]
    assert times.iloc[7] in (20, 30)
    assert math.isnan(times.iloc[3])


def test_figure_has_every_panel_also_on_one_core():
    from experiments.figures.bench_times import bench

    ways = (("released", 8.0), ("sklearn", 1.0), ("batched", 0.1))
    rows = [
        row(way, seconds, n, comparison)
        for comparison in ("parts", "faces", "landmarks", "jobs")
        for way, seconds in ways
        for n in (10, 20)
        if comparison == "faces" or n == 10
    ]
    rows += [row("batched", math.nan, 30, "faces"), row("lifting", 0.001)]
    table = table_of(rows)
    panel = bench(table).axes[0]
    assert [text.get_text() for text in panel.texts] == ["×80"], "of ours, not of another method"
    assert "Lifting" in {text.get_text() for text in panel.get_legend().get_texts()}
    titles = [axes.get_title() for axes in bench(table).axes]
    assert len(titles) == 4
    single_threaded = bench(table[table["comparison"] != "jobs"]).axes[3]
    assert "one core" in single_threaded.texts[0].get_text()
    assert isinstance(table, pd.DataFrame)


def test_every_way_to_train_mobileface_has_the_same_mini_batches():
    from experiments.bench.mobileface_steps import WAYS, mini_batches

    rng = np.random.default_rng(5)
    images = rng.integers(0, 256, (6, 4, 4, 3), np.uint8)
    scaled, targets = np.float32(images / 127.5 - 1), np.float32(rng.standard_normal((6, 2)))
    rows = np.array([[5, 0], [2, 2], [1, 4]])
    for way in WAYS:
        stored = {"uint8": images, "float32": scaled}[way.stored]
        made = list(mini_batches(way, stored, targets, rows).as_numpy_iterator())
        for own, (some_images, some_targets) in zip(rows, made, strict=True):
            np.testing.assert_allclose(some_images, scaled[own], atol=1e-6, err_msg=way.name)
            np.testing.assert_array_equal(some_targets, targets[own], err_msg=way.name)
