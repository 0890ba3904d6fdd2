"""Errors of detectors: in the upright face, by yaw, without faces that were not found."""

import numpy as np
import pytest

from deepmds_keras.normalisation import rms_radius
from experiments.pretrained.detector_errors import (
    BINS,
    detection_table,
    errors_on,
    summarise_errors,
    turned,
    upright,
)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def test_an_error_is_the_same_however_the_face_leans_and_how_large_it_is(rng):
    view, error = rng.normal(0, 1, (1, 51, 2)), rng.normal(0, 0.05, (1, 51, 2))
    for roll, size in ((0.0, 1.0), (25.0, 80.0)):
        roll = np.array([roll])
        pixels = size * turned(view, roll) * (1, -1) + 100
        found = size * turned(view + error, roll) * (1, -1) + 100
        own = upright(found - pixels, rms_radius(pixels), roll)
        assert np.allclose(own, error / rms_radius(view)[:, None, None])


def test_summary_keeps_mean_variance_and_what_goes_together(rng):
    n = 4000
    yaw = rng.choice(BINS, n)
    common = rng.normal(0, 0.05, (n, 1, 1)) * np.ones((51, 2))
    errors = 0.02 * np.sign(yaw)[:, None, None] + common + rng.normal(0, 0.01, (n, 51, 2))
    views = rng.normal(0, 1, (n, 51, 2))
    found = summarise_errors(errors, views, yaw)
    assert np.allclose(found.bias[0], -0.02, atol=0.01)
    assert np.allclose(found.bias[-1], 0.02, atol=0.01)
    views = np.broadcast_to(found.view[2], (5000, 51, 2))
    drawn = found.sample(views, np.full(5000, BINS[2]), rng)
    assert np.allclose(drawn.std(0), np.hypot(0.05, 0.01), rtol=0.1)
    assert np.corrcoef(drawn[:, 3, 0], drawn[:, 40, 1])[0, 1] > 0.9


def test_faces_pulled_to_their_mean_are_found_so(rng):
    n = 4000
    shapes = rng.normal(0, 1, (51, 2)) + np.einsum(
        "nr,rld->nld", rng.normal(0, 0.1, (n, 3)), rng.normal(0, 1, (3, 51, 2))
    )
    errors = -0.4 * (shapes - shapes.mean(0)) + rng.normal(0, 0.01, (n, 51, 2))
    found = summarise_errors(errors, shapes, np.zeros(n))
    drawn = found.sample(shapes[:500], np.zeros(500), rng)
    assert np.abs(drawn - errors[:500]).max() < 0.15
    assert (drawn - errors[:500]).std() < 0.02 < errors.std() / 3
    middle = np.flatnonzero(BINS == 0)[0]
    assert found.components[middle].std() < 0.01, "nothing of it is left to chance"
    np.testing.assert_allclose(found.sd**2, (errors**2).mean((0, 2)) / len(BINS), rtol=0.1)


def test_bins_without_faces_say_nothing():
    found = summarise_errors(np.zeros((0, 51, 2)), np.zeros((0, 51, 2)), np.zeros(0))
    assert found.bias.shape == (len(BINS), 51, 2) and not found.sd.any()


def test_what_is_not_the_face_is_not_its_error(rng):
    pixels = rng.normal(0, 40, (3, 68, 2)) + 160
    photos = {"pixels_ibug68": pixels, "roll": np.zeros(3), "dlib": pixels + 1}
    photos["dlib"][1] += 60
    photos["dlib"][2] = np.nan
    errors, views, found = errors_on(photos, "dlib", "ibug68")
    assert [*found] == [True, False, False]
    assert np.allclose(errors[0] * rms_radius(pixels[:1, 17:])[0], (1, -1))


def test_faces_that_are_not_found_are_counted_by_yaw(rng):
    pixels = np.tile(rng.normal(0, 40, (1, 68, 2)) + 160, (6, 1, 1))
    photos = {"pixels_ibug68": pixels, "roll": np.zeros(6), "dlib": pixels + (3, 4)}
    photos["yaw"] = np.array([0.0, 2, -5, 4, 41, 45])
    photos["dlib"][3:5] = np.nan
    table = detection_table(photos, "dlib", "ibug68").set_index("yaw")
    assert table.loc[0, ["n_photos", "found"]].tolist() == [4, 0.75]
    assert table.loc[40, "found"] == 0.5 and np.isnan(table.loc[-60, "rms"])
    expected = 100 * np.sqrt((9 + 16) / 2) / rms_radius(pixels[:1, 17:])[0]
    np.testing.assert_allclose(table.loc[0, "rms"], expected)
