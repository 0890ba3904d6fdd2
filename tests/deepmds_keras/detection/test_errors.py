"""Measured errors of detectors: read, converted, and sampled as they were measured."""

import numpy as np
import pytest

from deepmds_keras.detection import errors
from deepmds_keras.detection.errors import DetectorErrors, detector_errors, write_errors


@pytest.fixture
def measured():
    rng = np.random.default_rng(0)
    return DetectorErrors(
        yaw=np.array([-30.0, 30.0]),
        bias=rng.normal(0, 0.02, (2, 68, 2)),
        components=rng.normal(0, 0.01, (2, 3, 68, 2)),
        rest=np.full((2, 68, 2), 0.01),
    )


def test_samples_have_the_bias_and_the_spread_of_their_yaw(measured):
    drawn = measured.sample(np.full(20_000, 25.0), np.random.default_rng(1))
    assert np.allclose(drawn.mean(0), measured.bias[1], atol=1e-3)
    variance = (measured.components[1] ** 2).sum(0) + 0.01**2
    assert np.allclose(drawn.var(0), variance, rtol=0.1)
    flat = drawn[:, :, 0] - drawn[:, :, 0].mean(0)
    together = (flat[:, 0] * flat[:, 1]).mean()
    expected = (measured.components[1, :, 0, 0] * measured.components[1, :, 1, 0]).sum()
    assert together == pytest.approx(expected, abs=1e-5)


def test_sd_is_the_root_mean_square_of_samples(measured):
    yaw = np.repeat(measured.yaw, 10_000)
    drawn = measured.sample(yaw, np.random.default_rng(1))
    assert np.allclose(np.sqrt((drawn**2).mean((0, 2))), measured.sd, rtol=0.03)


def test_what_is_written_is_read_in_the_landmarks_that_are_asked_for(
    measured, tmp_path, monkeypatch
):
    monkeypatch.setattr(errors, "FOLDER", tmp_path)
    assert detector_errors("dlib", "ibug51") is None
    write_errors(measured, "dlib", "ibug68")
    found = detector_errors("dlib", "ibug51")
    assert np.allclose(found.bias, measured.bias[:, 17:], atol=1e-4)
    assert np.allclose(found.components, measured.components[:, :, 17:], atol=1e-4)
