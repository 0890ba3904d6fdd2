"""Non-metric MDS: true distances come back as the shape, and only the order of distances counts."""

import sys
from functools import partial

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform

from deepmds_keras import InputError, align, embed
from deepmds_keras.embedding import SOLVERS, classical_scaling, compiled_solver, pairwise_distances


@pytest.fixture
def faces():
    return np.random.default_rng(0).random((4, 20, 3))


@pytest.fixture
def distances(faces):
    return np.array([squareform(pdist(face)) for face in faces])


def error(points, faces):
    return np.sqrt(((align(points, faces) - faces) ** 2).mean())


def test_true_distances_give_the_shape_in_its_size(faces, distances):
    points, stress = embed(distances, return_stress=True)
    assert error(points, faces) < 1e-8
    assert stress.max() < 1e-6
    assert np.allclose([pdist(p) for p in points], [pdist(f) for f in faces])


def test_start_alone_solves_euclidean_distances(faces, distances):
    assert error(classical_scaling(distances), faces) < 1e-8


def test_only_the_order_of_dissimilarities_counts(faces, distances):
    bent = distances**1.5 + 0.1 * (distances > 0)
    assert error(classical_scaling(bent), faces) > 0.02  # a metric method is misled
    assert error(embed(bent, eps=1e-9, max_iter=3000), faces) < 0.02


def test_scale_of_the_dissimilarities_is_the_scale_of_the_points(distances):
    assert np.allclose(embed(7 * distances), 7 * embed(distances), atol=1e-6)


def test_batch_equals_one_by_one_equals_two_processes(distances):
    many = np.concatenate([distances] * 12)  # more than one task
    together = embed(many)
    assert np.array_equal(together[:4], np.stack([embed(matrix) for matrix in distances]))
    assert np.array_equal(together, embed(many, n_jobs=2))


def test_points_are_centred_on_their_principal_axes(distances):
    for points in embed(distances):
        assert np.allclose(points.mean(0), 0)
        moments = points.T @ points
        assert np.allclose(moments, np.diag(np.diag(moments)), atol=1e-8)
        assert (np.diff(np.diag(moments)) <= 0).all()


@pytest.mark.parametrize(
    "solve", [classical_scaling, *(partial(embed, solver=solver) for solver in SOLVERS)]
)
def test_the_sign_of_an_axis_hangs_neither_on_rounding_nor_on_symmetry(faces, solve):
    half = faces * [1, 0.7, 0.4] + [1, 0, 0]
    symmetric = np.concatenate([half, half * [-1, 1, 1]], 1)
    matrices = np.array([squareform(pdist(face)) for face in symmetric])
    expected = solve(matrices)
    rng = np.random.default_rng(1)
    for _ in range(5):  # the rounding errors of another processor
        error = squareform(rng.uniform(-1e-14, 1e-14, matrices[0].size // 2 - 20))
        np.testing.assert_allclose(solve(matrices * (1 + error)), expected, atol=1e-6)


def test_progress_counts_every_face(distances):
    done = []
    embed(np.concatenate([distances] * 12), progress=done.append)
    assert sum(done) == 48


def test_diagonal_and_slightly_negative_entries_do_no_harm(faces, distances):
    dirty = distances.copy()
    dirty[:, np.arange(20), np.arange(20)] = 0.007
    dirty[:, 0, 1] = dirty[:, 1, 0] = -0.01
    assert error(embed(dirty), faces) < 0.05


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda d: d[:, :5], "square matrices"),
        (lambda d: d[0, 0], "square matrices"),
        (lambda d: np.where(d > 1, np.nan, d), "finite"),
        (lambda d: d + np.triu(np.ones((20, 20))), "symmetric"),
        (lambda d: -d, "must not be negative"),
        (lambda d: 0 * d, "must not all be zero"),
    ],
)
def test_bad_matrices_are_named(distances, spoil, message):
    with pytest.raises(InputError, match=message):
        embed(spoil(distances))


@pytest.mark.parametrize("n_components", [2, 3])
def test_batched_solver_gives_what_sklearn_gives(n_components):
    rng = np.random.default_rng(5)
    points = rng.normal(size=(40, 30, 3))
    true = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)
    noise = 0.1 * np.triu(rng.normal(size=true.shape), 1)
    matrices = np.abs(true + noise + np.swapaxes(noise, 1, 2))
    matrices[:, np.arange(30), np.arange(30)] = 0
    (a, stress_a), (b, stress_b) = (
        embed(matrices, n_components, solver=solver, return_stress=True) for solver in SOLVERS
    )
    np.testing.assert_allclose(stress_a, stress_b, rtol=1e-9)
    np.testing.assert_allclose(align(b, a), a, atol=1e-8)


def test_scale_is_the_one_with_the_least_squares():
    points = np.random.default_rng(6).normal(size=(12, 3))
    matrix = np.linalg.norm(points[:, None] - points, axis=-1) ** 1.3
    found = embed(matrix)
    distances = np.linalg.norm(found[:, None] - found, axis=-1)

    def misfit(scale):
        return np.square(scale * distances - matrix).sum()

    assert misfit(1) < min(misfit(0.999), misfit(1.001))


def test_without_numba_the_batched_solver_is_that_of_scikit_learn(distances, monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    monkeypatch.delitem(sys.modules, "deepmds_keras.compiled_mds", raising=False)
    compiled_solver.cache_clear()
    try:
        assert compiled_solver() is None
        assert np.array_equal(embed(distances, solver="batched"), embed(distances))
    finally:
        compiled_solver.cache_clear()


def test_with_numba_the_batched_solver_is_compiled():
    pytest.importorskip("numba", reason="numba is not installed")
    assert compiled_solver().__module__ == "deepmds_keras.compiled_mds"


def test_unknown_solver_is_named():
    with pytest.raises(InputError, match="solver must be one of sklearn, batched. Received 'new'"):
        embed(np.ones((4, 4)), solver="new")


def test_distances_are_those_of_all_pairs():
    points = np.random.default_rng(0).random((2, 5, 3))
    found = pairwise_distances(points)
    assert found.shape == (2, 5, 5)
    assert found[1, 2, 4] == pytest.approx(np.linalg.norm(points[1, 2] - points[1, 4]))
