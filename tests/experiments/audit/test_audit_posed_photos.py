"""Claims on photos and data sets: each check gives the other verdict where the claim is false."""

import numpy as np
import pandas as pd
import pytest

from experiments.audit import data_sets, posed_photos
from experiments.audit.poses import SWEEPS
from experiments.presets import TINY
from experiments.run import Run
from experiments.verdicts import DOES_NOT_HOLD, HOLDS, UNKNOWN, WITH_CONDITION

YAWS = np.array(SWEEPS["yaw"])


def along(farther):
    """Errors of 1 up to 45 degrees and in front of another number."""
    return [1e-4 * (farther if abs(yaw) == 45 else 1.0) for yaw in YAWS]


@pytest.mark.parametrize(
    ("ours", "stable", "verdict"),
    [(1.4, 1.0, HOLDS), (1.6, 1.0, WITH_CONDITION), (1.6, 1.6, DOES_NOT_HOLD)],
)
def test_51_landmarks_are_independent_of_the_pose_if_errors_stay_alike(ours, stable, verdict):
    swept = {"ours": along(ours), "ours_stable": along(stable), "mean_shape": along(1.0)}
    assert posed_photos.pose_invariant_51(swept).verdict == verdict
    assert posed_photos.pose_invariant_51(None).verdict == UNKNOWN


def test_mediapipe_fails_on_posed_images_if_it_finds_fewer_of_them():
    assert posed_photos.mediapipe_poses({"0": 1.0, "60": 0.9}).verdict == HOLDS
    assert posed_photos.mediapipe_poses({"0": 0.99, "60": 0.99}).verdict == DOES_NOT_HOLD
    assert posed_photos.mediapipe_poses(None).verdict == UNKNOWN


def test_detections_are_counted_over_both_models_and_sides(tmp_path):
    run = Run("ict", TINY, results=tmp_path)
    assert posed_photos.measure_detections(run) is None
    folder = tmp_path / "tiny" / "openhead" / "pretrained"
    folder.mkdir(parents=True)
    rows = [
        ("mediapipe", -60, 10, 0.5), ("mediapipe", 60, 30, 0.9), ("mediapipe", 0, 10, 1.0),
        ("dlib", 60, 10, 0.0),
    ]  # fmt: skip
    table = pd.DataFrame(rows, columns=["detector", "yaw", "n_photos", "found"])
    table.to_csv(folder / "detection.csv", index=False)
    assert posed_photos.measure_detections(run) == {"0": 1.0, "60": 32 / 40}


def test_a_test_set_is_as_large_as_is_said_or_not():
    assert data_sets.size_of_test_sets(5000, 3937).verdict == DOES_NOT_HOLD
    assert data_sets.size_of_test_sets(3000, 3937).verdict == HOLDS
