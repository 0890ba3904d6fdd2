"""The authors' evaluator: what it makes of Zhao's depth, and that it leaves the others alone."""

import numpy as np
import pytest

from data_gen.datasets.dataset import make_dataset
from deepmds_keras.geometry.alignment import align
from deepmds_keras.geometry.units import normalise
from deepmds_keras.metrics import depth_corr, mse
from experiments.tracks.bfm import TRUE_DEPTH, as_released


@pytest.fixture(scope="module")
def truth(head):
    faces = make_dataset(head, 200, np.random.default_rng(0))
    return normalise(faces.landmarks)


def test_a_perfect_depth_scores_what_the_paper_prints_for_zhao(truth):
    aligned = align(as_released({}, truth)[TRUE_DEPTH], truth)
    error, correlation = mse(aligned, truth).mean(), depth_corr(aligned, truth).mean()
    # The paper: 22e-4 and 71.42 (BFM), 71.46 (CelebA).
    assert 1.8e-3 < error < 2.6e-3
    assert 71.3 < correlation < 71.6


def test_only_the_depths_course_counts_not_its_size_or_place(truth):
    shapes = truth * (5, -2, 0.1) + (0, 3, 7)
    released = as_released({"zhao_frontal": shapes}, truth)
    assert np.allclose(released["zhao_frontal"], released[TRUE_DEPTH])


def test_the_depth_is_that_of_the_face_before(truth):
    depth = as_released({}, truth)[TRUE_DEPTH][..., 2]
    assert np.allclose(depth.min(1), 0)
    assert np.allclose(depth.max(1), 1)
    before = truth[:-1, :, 2]
    rescaled = (before - before.min(1, keepdims=True)) / np.ptp(before, axis=1, keepdims=True)
    assert np.allclose(depth[1:], rescaled)


def test_other_methods_are_left_alone(truth):
    given = {"deep_mds": truth + 1, "zhao": truth}
    released = as_released(given, truth)
    assert released["deep_mds"] is given["deep_mds"]
    assert given["zhao"] is truth
    assert {*released} == {"deep_mds", "zhao", TRUE_DEPTH}
