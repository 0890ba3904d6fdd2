"""Non-metric MDS: true distances come back as the shape, by either solver, from the same start."""

import sys
from functools import partial

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform

from deepmds_keras import DeepMDS, InputError, MissingPackageError, align, embed
from deepmds_keras.compiled_mds import compiled_mds
from deepmds_keras.embedding import sklearn_mds
from deepmds_keras.geometry.classical_scaling import classical_scaling

pytestmark = pytest.mark.usefixtures("one_thread")


def symmetric(matrices):
    """With a zero diagonal."""
    upper = np.triu(matrices, 1)
    return upper + np.swapaxes(upper, -1, -2)


def clouds(n=3, n_landmarks=30):
    """As wide, high and deep as faces."""
    return np.random.default_rng(0).standard_normal((n, n_landmarks, 3)) * [1, 0.8, 0.4]


def noisy(shapes, noise=0.03):
    """Their distances, with relative errors."""
    distances = np.array([squareform(pdist(shape)) for shape in shapes])
    error = np.random.default_rng(1).standard_normal(distances.shape)
    return symmetric(distances * (1 + noise * error))


def error(points, shapes):
    return np.sqrt(((align(points, shapes) - shapes) ** 2).mean())


def test_true_distances_give_the_shape_in_its_size_on_its_principal_axes():
    shapes = clouds()
    points, stress = embed(7 * noisy(shapes, 0), return_stress=True)
    assert error(points / 7, shapes) < 1e-8 and stress.max() < 1e-6
    assert np.allclose([pdist(p) for p in points], [7 * pdist(s) for s in shapes])
    for moments in np.swapaxes(points, 1, 2) @ points:
        assert np.allclose(moments, np.diag(np.diag(moments)), atol=1e-8)
        assert (np.diff(np.diag(moments)) <= 0).all()
    assert np.allclose(points.mean(1), 0)


@pytest.mark.parametrize(("solver", "copies"), [("numba", 40), ("sklearn", 9)])
def test_batch_equals_one_by_one_equals_two_jobs(solver, copies):
    distances, done = noisy(clouds(4)), []
    many = np.concatenate([distances] * copies)  # more than one task
    together = embed(many, solver=solver, progress=done.append)
    assert sum(done) == 4 * copies
    one_by_one = np.stack([embed(matrix, solver=solver) for matrix in distances])
    assert np.array_equal(together[:4], one_by_one)
    assert np.array_equal(together, embed(many, solver=solver, n_jobs=2))


@pytest.mark.parametrize(
    "solve", [classical_scaling, partial(embed, solver="sklearn"), partial(embed, solver="numba")]
)
def test_the_sign_of_an_axis_depends_neither_on_rounding_nor_on_symmetry(solve):
    half = np.random.default_rng(0).random((4, 20, 3)) * [1, 0.7, 0.4] + [1, 0, 0]
    matrices = noisy(np.concatenate([half, half * [-1, 1, 1]], 1), 0)
    expected = solve(matrices)
    rng = np.random.default_rng(1)
    for _ in range(5):  # the rounding errors of another processor
        rounding = squareform(rng.uniform(-1e-14, 1e-14, matrices[0].size // 2 - 20))
        np.testing.assert_allclose(solve(matrices * (1 + rounding)), expected, atol=1e-6)


def test_diagonal_and_slightly_negative_entries_do_no_harm():
    shapes = clouds()
    dirty = noisy(shapes, 0) + 0.007 * np.eye(30)
    dirty[:, 0, 1] = dirty[:, 1, 0] = -0.01
    assert error(embed(dirty), shapes) < 0.05


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda d: d[:, :5], "square matrices"),
        (lambda d: d[0, 0], "square matrices"),
        (lambda d: np.where(d > 1, np.nan, d), "finite"),
        (lambda d: d + np.triu(np.ones((30, 30))), "symmetric"),
        (lambda d: -d, "must not be negative"),
        (lambda d: 0 * d, "must not all be zero"),
    ],
)
def test_bad_matrices_are_named(spoil, message):
    with pytest.raises(InputError, match=message):
        embed(spoil(noisy(clouds())))
    with pytest.raises(InputError, match="n_components must be at most 30.* Received 31"):
        embed(noisy(clouds()), 31)


@pytest.fixture
def without_numba(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    monkeypatch.delitem(sys.modules, "deepmds_keras.compiled_mds", raising=False)


def test_without_numba_its_solver_is_refused(without_numba):
    matrices = noisy(clouds())
    with pytest.raises(MissingPackageError, match=r"\.\[fast\]"):
        embed(matrices, solver="numba")


def test_the_default_is_the_papers_by_scikit_learn(without_numba):
    matrices = noisy(clouds())
    assert DeepMDS().solver == DeepMDS.pretrained("deepmds-ibug51").solver == "sklearn"
    assert np.array_equal(embed(matrices), embed(matrices, solver="sklearn"))
    with pytest.raises(InputError, match="one of sklearn, numba. Received 'new'"):
        embed(matrices, solver="new")
    with pytest.raises(InputError, match="n_jobs must be a whole number other than 0"):
        embed(matrices, n_jobs=0)


@pytest.mark.parametrize("solver", ["sklearn", "numba"])
def test_neither_the_unit_nor_a_distance_of_zero_changes_the_shape(solver):
    shape = clouds(1)[0]
    shape[1] = shape[0] + [1e-3, 0, 0]
    (distances,) = noisy([shape], 0)
    expected = embed(distances, solver=solver)
    for unit in (1e-300, 1e-15, 1e-9, 1e9, 1e300):
        points, stress = embed(unit * distances, solver=solver, return_stress=True)
        assert np.abs(points / unit - expected).max() < 1e-9 and stress < 1e-6
    distances[0, 1] = distances[1, 0] = 0  # not missing: the two landmarks coincide
    points = embed(distances, solver=solver)
    assert np.linalg.norm(points[0] - points[1]) < 0.01
    hidden = np.ma.array(noisy(clouds(1))[0], mask=False)
    hidden[3, 4] = hidden[4, 3] = np.ma.masked
    with pytest.raises(InputError, match="NaN, infinity or masked"):
        embed(hidden)


@pytest.mark.parametrize("k", [2, 3])
def test_solvers_agree_on_landmarks_that_coincide_in_the_start(k):
    hops = 1 + symmetric(np.random.default_rng(0).integers(0, 2, (40, 8, 8))).astype(float)
    points, expected = (embed(hops, k, solver=solver) for solver in ("numba", "sklearn"))
    np.testing.assert_allclose([*map(pdist, points)], [*map(pdist, expected)], atol=1e-6)


# The compiled solver takes the steps of scikit-learn and stops at the same one.


def compare(matrices, start, *limits):
    for matrix, first in zip(matrices, start, strict=True):
        points, stress, n_iter = compiled_mds(matrix, first, *limits)
        expected, expected_stress, expected_n_iter = sklearn_mds(matrix, first, *limits)
        assert n_iter == expected_n_iter
        assert stress == pytest.approx(expected_stress, rel=1e-9, abs=1e-12)
        assert np.abs(points - expected).max() < 1e-9 * np.abs(expected).max()


@pytest.mark.parametrize(
    "matrices",
    [
        pytest.param(noisy(clouds(2, 72)), id="72 landmarks"),
        pytest.param(noisy(clouds(20, 3), 0.3), id="3 landmarks"),
        pytest.param(noisy(clouds(), 0) ** 3, id="bent distances"),
        pytest.param(symmetric(np.random.default_rng(2).random((4, 20, 20))), id="no distances"),
        pytest.param(np.round(noisy(clouds()), 1), id="ties and a few missing pairs"),
        pytest.param(1 + np.round(noisy(clouds(), 0.3)), id="few values, many ties"),
        pytest.param(1 - np.eye(12)[None], id="all alike"),
        pytest.param(1e8 * noisy(clouds()), id="large unit"),
    ],
)
def test_points_stress_and_iterations_are_those_of_scikit_learn(matrices):
    compare(matrices, classical_scaling(matrices))


@pytest.mark.parametrize("n_components", [1, 2, 5])
@pytest.mark.parametrize("limits", [(1, 1e-6), (2, 1e-6), (300, 1e-3), (100, 1e-9)])
def test_dimensions_and_limits_are_those_of_scikit_learn(n_components, limits):
    start = np.random.default_rng(3).standard_normal((3, 30, n_components))
    start[:, 5] = start[:, 6]  # landmarks that start at one place are parted alike, too
    compare(noisy(clouds()), start, *limits)
