"""Scans of synthetic faces, and the landmarks that the paper's pipeline finds on them."""

import numpy as np
import pytest

from data_gen.models.registry import load_model
from data_gen.registration import GroundTruth
from deepmds_keras.landmarks import convert
from deepmds_keras.tool.detection.dlib_landmarks import shared_detector


def make_scans():
    """Two of three subjects of a substitute, in a process that may draw."""
    from data_gen.datasets.scans_substitute import ScansSubstitute

    model = load_model("openhead", scheme="ibug51")
    source = ScansSubstitute(model, 3, 7, [0, 5])
    counts = [source.scans_of(subject) for subject in range(3)]
    before = source.subject(1)
    return source.subject(0), before, source.subject(1), counts


@pytest.fixture(scope="module")
def scans(apart):
    return apart(make_scans)


def test_scans_are_spread_evenly_and_each_subject_is_the_same_whenever_it_is_drawn(scans):
    first, again, once, counts = scans
    assert counts == [3, 2, 2]
    assert [scan.condition for scan in first] == ["neutral", "smile", "laugh"]
    for one, other in zip(once, again, strict=True):
        assert one.name == other.name
        assert np.array_equal(one.image, other.image) and np.array_equal(one.points, other.points)
    eyes = [scan.truth[[19, 22, 25, 28]] for scan in (*first, *once)]
    assert np.abs(eyes[0] - eyes[3]).mean() > 3 * np.abs(eyes[0] - eyes[1]).mean()


def test_photo_and_points_are_of_the_same_face(scans):
    truth = GroundTruth(load_model("openhead", scheme="ibug51"))
    for scan in scans[0]:
        (detected,) = shared_detector().detect_all(scan.image)
        pixels = convert(detected, "ibug68", "ibug51")
        fit = truth.register(pixels, scan.points)
        assert np.median(np.linalg.norm(fit.landmarks - scan.truth, axis=1)) < 3.5
        pixels = np.int64(pixels)
        assert scan.image.shape == (320, 320, 3) and (scan.image[:, :5] == 255).all()
        assert (scan.image[pixels[:, 1], pixels[:, 0]] < 255).any(1).all()
