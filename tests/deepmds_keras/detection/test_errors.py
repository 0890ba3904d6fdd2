"""Measured errors of detectors: read, and sampled as they were measured."""

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
        view=rng.normal(0, 1, (2, 68, 2)),
        read=rng.normal(0, 0.1, (2, 2, 68, 2)),
        write=rng.normal(0, 0.01, (2, 2, 68, 2)),
        components=rng.normal(0, 0.01, (2, 3, 68, 2)),
        rest=np.full((2, 68, 2), 0.01),
    )


def test_samples_have_the_bias_and_the_spread_of_their_yaw(measured):
    yaw = np.full(20_000, 25.0)
    views = np.broadcast_to(measured.view[1], (20_000, 68, 2))
    drawn = measured.sample(views, yaw, np.random.default_rng(1))
    assert np.allclose(drawn.mean(0), measured.bias[1], atol=1e-3)
    variance = (measured.components[1] ** 2).sum(0) + 0.01**2
    assert np.allclose(drawn.var(0), variance, rtol=0.1)
    flat = drawn[:, :, 0] - drawn[:, :, 0].mean(0)
    together = (flat[:, 0] * flat[:, 1]).mean()
    expected = (measured.components[1, :, 0, 0] * measured.components[1, :, 1, 0]).sum()
    assert together == pytest.approx(expected, abs=1e-5)


def test_what_a_face_brings_about_is_the_same_each_time_and_bounded(measured):
    offset = measured.read[0, 0] / (measured.read[0, 0] ** 2).sum()
    numbers = np.einsum("ld,rld->r", offset, measured.read[0])
    expected = measured.bias[0] + np.tensordot(numbers, measured.write[0], 1)
    views = np.repeat([measured.view[0] + offset, measured.view[0] + 1e6 * offset], 4000, axis=0)
    drawn = measured.sample(views, np.full(8000, -30.0), np.random.default_rng(1))
    assert np.allclose(drawn[:4000].mean(0), expected, atol=2e-3)
    assert np.abs(drawn[4000:]).max() < 0.5, "no further than three s.d. of a read number"


def test_sd_is_the_root_mean_square_of_samples(measured):
    rng = np.random.default_rng(1)
    yaw = np.repeat(measured.yaw, 10_000)
    # Views whose read numbers are white, as those that were measured.
    inverse = np.stack([np.linalg.pinv(own.reshape(2, -1)).T for own in measured.read])
    offsets = inverse[np.repeat([0, 1], 10_000)].reshape(-1, 2, 68, 2)
    offsets = np.einsum("nr,nrld->nld", rng.standard_normal((20_000, 2)), offsets)
    views = np.repeat(measured.view, 10_000, axis=0) + offsets
    drawn = measured.sample(views, yaw, rng)
    assert np.allclose(np.sqrt((drawn**2).mean((0, 2))), measured.sd, rtol=0.03)


def test_what_is_written_is_read_for_its_scheme_alone(measured, tmp_path, monkeypatch):
    monkeypatch.setattr(errors, "FOLDER", tmp_path)
    write_errors(measured, "dlib", "ibug68")
    assert detector_errors("dlib", "ibug51") is None
    found = detector_errors("dlib", "ibug68")
    assert np.allclose(found.bias, measured.bias, atol=1e-4)
    assert np.allclose(found.read, measured.read, atol=1e-3)
