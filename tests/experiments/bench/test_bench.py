"""The compared ways do the same, and their times are those of the same faces."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import runs
from faces import mean_landmarks, rotation_of
from scipy.spatial.distance import pdist

from data_gen.datasets.dataset import make_dataset
from deepmds_keras import proximities
from deepmds_keras.deep_mds import DeepMDS
from deepmds_keras.geometry.alignment import align
from deepmds_keras.geometry.units import normalise
from deepmds_keras.geometry.views import project
from deepmds_keras.training import Recipe, train_dissimilarity_net
from experiments.bench import released_code as released
from experiments.bench.bench import training, with_ratios
from experiments.bench.released_code import viewmtx

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def networks():
    return DeepMDS.pretrained("deepmds-bfm72")


@pytest.fixture(scope="module")
def faces(head):
    return make_dataset(head, 8, np.random.default_rng(0))


def test_faces_one_by_one_are_those_of_a_batch(head, faces):
    landmarks, views = released.make_faces(head, faces, len(faces), "bfm72")
    np.testing.assert_allclose(landmarks, faces.landmarks, atol=1e-4)
    np.testing.assert_allclose(views, faces.views, atol=1e-4)


def test_released_training_batches_are_the_features_and_distances_of_each_face(faces):
    views, shapes = faces.views[:2], faces.landmarks[:2]
    batches = released.training_batches(views, shapes)
    for (features, distances), view, shape in zip(batches, views, shapes, strict=True):
        np.testing.assert_allclose(features, proximities.pair_features(view, "paper"), rtol=1e-6)
        np.testing.assert_allclose(distances.ravel(), pdist(shape), rtol=1e-6)


def test_one_predict_a_face_gives_the_dissimilarities_of_a_batch(networks, faces):
    frontal, matrices = released.predict(networks, faces.views[:2])
    np.testing.assert_allclose(frontal, networks.frontalise(faces.views[:2]), atol=1e-6)
    np.testing.assert_allclose(matrices, networks.dissimilarities(faces.views[:2]), atol=1e-5)


def test_one_classical_start_recovers_the_points_of_exact_distances():
    shape = mean_landmarks("ibug51")
    (points,) = released.embed(np.linalg.norm(shape[:, None] - shape, axis=-1))
    assert np.corrcoef(pdist(points), pdist(shape))[0, 1] > 0.99


def test_viewmtx_gives_the_numbers_of_matlabs_help():
    point = np.array([0.5, 0, -3, 1])
    np.testing.assert_allclose((viewmtx(-37.5, 30) @ point)[:2], [0.3967, -2.4459], atol=5e-5)
    view = viewmtx(-37.5, 30, 25) @ point
    np.testing.assert_allclose(view[:2] / view[3], [0.1777, -1.8858], atol=5e-5)


@pytest.mark.parametrize(
    ("angles", "azimuth", "elevation"), [({"pitch": 20.0}, 0, 70), ({"roll": 30.0}, -30, 90)]
)
def test_from_above_an_azimuth_is_a_roll_and_an_elevation_a_pitch(angles, azimuth, elevation):
    turn = rotation_of(**angles)
    np.testing.assert_allclose(viewmtx(azimuth, elevation)[:3, :3], turn, atol=1e-12)


def test_released_views_without_perspective_are_ours(faces):
    """Up to position, size and turn in the image: ours have other axes."""
    cameras = replace(faces.cameras, field_of_view=np.zeros(len(faces)))
    orthographic = replace(cameras, projection=np.zeros(len(faces), int))
    expected = project(faces.landmarks, orthographic)
    views = align(released.released_views(faces.landmarks, cameras), expected, reflection=False)
    np.testing.assert_allclose(views, expected, atol=1e-4)


@pytest.mark.slow
def test_the_training_that_is_timed_as_ours_is_our_training(faces):
    shapes, steps = np.float32(normalise(faces.landmarks)), 5
    expected, _ = train_dissimilarity_net(shapes[..., :2], shapes, Recipe(1, steps))
    expected = np.concatenate([w.ravel() for w in expected.get_weights()])
    for way, tolerance in (("deep_mds", 0), ("released", 1e-2)):
        network, epoch = training(way, shapes[..., :2], shapes, steps)
        epoch()
        weights = np.concatenate([w.ravel() for w in network.get_weights()])
        assert np.linalg.norm(weights - expected) <= tolerance * np.linalg.norm(expected), way


def test_ratios_are_those_of_faces_in_a_second_at_the_same_part():
    table = with_ratios(
        [
            ("parts", "embedding", "released", 4, 8.0),
            ("parts", "embedding", "sklearn", 30, 3.0),
            ("parts", "embedding", "numba", 100, 1.0),
            ("one face", "one face at a time", "sklearn", 10, 3.0),
        ]
    )
    assert table["ms_per_face"].tolist() == [2000, 100, 10, 300]
    assert table["times_released"].tolist()[:3] == [1, 20, 200]
    assert table["times_sklearn"].tolist() == [0.05, 1, 10, 1]
    assert table["times_numba"].isna().tolist() == [False] * 3 + [True]


@pytest.mark.slow
def test_bench_times_every_part_beside_the_released_way(tmp_path):
    runs.succeed("bench.bench", tmp_path)
    table = pd.read_csv(tmp_path / "results" / "tiny" / "bench" / "bench.csv")
    ways = table[table["comparison"] == "parts"].groupby("part", sort=False)["way"].agg(set)
    assert all("released" in names and len(names) > 1 for names in ways)
    assert {"sklearn", "numba", "landmark_lifter"} < ways["end to end"]
    assert (table["seconds"] > 0).all()
