"""Procrustes alignment: what it undoes, what it may not undo, and that it is the best."""

import numpy as np
import pytest
from scipy.spatial import procrustes
from scipy.stats import ortho_group

from deepmds_keras import InputError, align


@pytest.fixture
def target():
    return np.random.default_rng(0).normal(size=(5, 12, 3))


def test_without_scaling_size_is_kept(target):
    aligned = align(2 * target, target, scaling=False)
    assert np.allclose(aligned.std((1, 2)), 2 * target.std((1, 2)), rtol=0.1)
    assert np.allclose(aligned - aligned.mean(1, keepdims=True),
                       2 * (target - target.mean(1, keepdims=True)))  # fmt: skip


def test_agrees_with_scipy(target):
    source = target + np.random.default_rng(2).normal(0, 0.3, target.shape)
    aligned = align(source, target)
    for face in range(len(target)):
        _, _, disparity = procrustes(target[face], source[face])
        centred = target[face] - target[face].mean(0)
        assert np.isclose(
            ((aligned[face] - target[face]) ** 2).sum() / (centred**2).sum(), disparity
        )


def test_one_target_serves_all_sources(target):
    mean = target.mean(0)
    sources = mean @ ortho_group(3, seed=5).rvs(4)
    assert np.allclose(align(sources, mean), mean)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (np.zeros((5, 11, 3)), "same shape"),
        (np.zeros((4, 12, 3)), "one face or one for each"),
        (np.full((5, 12, 3), np.nan), "finite"),
    ],
)
def test_bad_input_is_named(target, source, message):
    with pytest.raises(InputError, match=message):
        align(source, target)
