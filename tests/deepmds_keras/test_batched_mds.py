"""The batched solver takes the steps of scikit-learn, compiled or not, in whatever company."""

import sys
import tracemalloc

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform
from sklearn.isotonic import IsotonicRegression

import deepmds_keras
from deepmds_keras import batched_mds as module
from deepmds_keras.batched_mds import batched_mds, smacof_solver
from deepmds_keras.embedding import classical_scaling, non_metric_mds

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(params=["compiled", "scipy"], autouse=True)
def solver(request, monkeypatch):
    if request.param == "compiled":
        pytest.importorskip("numba", reason="numba is not installed")
        from deepmds_keras.compiled_smacof import smacof
    else:
        smacof = module.smacof
    monkeypatch.setattr(module, "smacof_solver", lambda: smacof)


def symmetric(matrices):
    """With a zero diagonal."""
    upper = np.triu(matrices, 1)
    return upper + np.swapaxes(upper, -1, -2)


def faces(n=3, n_landmarks=30, noise=0.03, seed=0):
    """Distances within clouds as wide, high and deep as faces, with relative errors."""
    rng = np.random.default_rng(seed)
    shapes = rng.standard_normal((n, n_landmarks, 3)) * [1, 0.8, 0.4]
    distances = np.array([squareform(pdist(shape)) for shape in shapes])
    return symmetric(distances * (1 + noise * rng.standard_normal(distances.shape)))


def of_scikit_learn(matrices, start, max_iter=300, eps=1e-6):
    points, stress, n_iter = np.empty(start.shape), np.empty(len(start)), np.empty(len(start), int)
    for face, matrix in enumerate(matrices):
        scaling = non_metric_mds(start.shape[2], n_init=1, max_iter=max_iter, eps=eps)
        points[face] = scaling.fit_transform(matrix, init=start[face])
        stress[face], n_iter[face] = scaling.stress_, scaling.n_iter_
    return points, stress, n_iter


def same_bits(results, others):
    return all(np.array_equal(a, b) for a, b in zip(results, others, strict=True))


def lattice():
    return squareform(pdist(np.stack(np.meshgrid(*[range(3)] * 3), -1).reshape(-1, 3)))[None]


def with_missing_pairs():
    missing = symmetric(np.random.default_rng(1).random((3, 30, 30))) < 0.2
    return np.where(missing, 0, faces())


@pytest.mark.parametrize(
    "matrices",
    [
        pytest.param(faces(), id="faces"),
        pytest.param(faces(2, 72), id="72 landmarks"),
        pytest.param(faces(20, 4, noise=0.3), id="4 landmarks"),
        pytest.param(faces(20, 3, noise=0.3), id="3 landmarks"),
        pytest.param(faces(noise=0), id="exact distances"),
        pytest.param(faces(noise=0) ** 3, id="bent distances"),
        pytest.param(faces(noise=0.5), id="hardly distances"),
        pytest.param(symmetric(np.random.default_rng(2).random((4, 20, 20))), id="no distances"),
        pytest.param(np.round(faces(), 1), id="ties and a few missing pairs"),
        pytest.param(1 + np.round(faces(noise=0.3)), id="few values, many ties"),
        pytest.param(with_missing_pairs(), id="missing pairs"),
        pytest.param(lattice(), id="ties but for rounding"),
        pytest.param(1 - np.eye(12)[None], id="all alike"),
        pytest.param(1e8 * faces(), id="large unit"),
    ],
)
def test_points_stress_and_iterations_are_those_of_scikit_learn(matrices):
    start = classical_scaling(matrices)
    points, stress, n_iter = batched_mds(matrices, start)
    expected, expected_stress, expected_n_iter = of_scikit_learn(matrices, start)
    assert np.array_equal(n_iter, expected_n_iter)
    assert np.allclose(stress, expected_stress, rtol=1e-9, atol=1e-12)
    assert np.abs(points - expected).max() < 1e-9 * np.abs(expected).max()


@pytest.mark.parametrize("n_components", [1, 2, 5])
@pytest.mark.parametrize(("max_iter", "eps"), [(1, 1e-6), (2, 1e-6), (300, 1e-3), (100, 1e-9)])
def test_dimensions_and_limits_are_those_of_scikit_learn(n_components, max_iter, eps):
    matrices = faces(3)
    start = np.random.default_rng(3).standard_normal((3, 30, n_components))
    points, stress, n_iter = batched_mds(matrices, start, max_iter, eps)
    expected, expected_stress, expected_n_iter = of_scikit_learn(matrices, start, max_iter, eps)
    assert np.array_equal(n_iter, expected_n_iter)
    assert np.allclose(stress, expected_stress, rtol=1e-9)
    assert np.abs(points - expected).max() < 1e-9 * np.abs(expected).max()


def test_landmarks_that_start_at_one_place_are_parted_as_by_scikit_learn():
    matrices, start = faces(2), np.random.default_rng(4).standard_normal((2, 30, 3))
    start[:, 5] = start[:, 6]
    points, _, n_iter = batched_mds(matrices, start)
    expected, _, expected_n_iter = of_scikit_learn(matrices, start)
    assert np.array_equal(n_iter, expected_n_iter)
    assert np.abs(points - expected).max() < 1e-6


def test_ties_but_for_rounding_are_ties():
    tied = symmetric(0.5 + np.round(faces(1, noise=0.1), 1) / 20)
    rounding = np.random.default_rng(5).integers(0, 20, tied.shape) * 2.0**-53
    matrices = symmetric(tied + rounding)
    smallest, groups = 0.0, {}
    for value in np.unique(matrices):
        smallest = value if value - smallest >= 1e-15 else smallest  # as scikit-learn has it
        groups[value] = smallest
    grouped = np.vectorize(groups.get)(matrices)
    start = classical_scaling(tied)
    points = batched_mds(matrices, start)[0]
    assert np.allclose(points, batched_mds(grouped, start)[0], atol=1e-9)
    assert not np.allclose(points, batched_mds(tied, start)[0], atol=1e-6)


def test_a_face_has_the_same_bits_alone_in_any_order_and_in_any_chunk(monkeypatch):
    matrices = np.concatenate([faces(), faces(noise=0.3, seed=1), np.round(faces(5), 1)])
    start = classical_scaling(matrices)
    together = batched_mds(matrices, start)
    for face in range(len(matrices)):
        own = slice(face, face + 1)
        assert same_bits(batched_mds(matrices[own], start[own]), [a[own] for a in together])
    assert same_bits(batched_mds(matrices[::-1], start[::-1]), [a[::-1] for a in together])
    monkeypatch.setattr(module, "_PAIRS_AT_ONCE", 4 * 435 + 1)
    assert same_bits(batched_mds(matrices, start), together)


def test_arrays_that_must_not_be_written_are_not():
    matrices = faces()
    start = classical_scaling(matrices)
    expected = batched_mds(matrices.copy(), start.copy())
    matrices.flags.writeable = start.flags.writeable = False
    assert same_bits(batched_mds(matrices, start), expected)


def test_stress_falls_with_every_iteration():
    matrices = faces(noise=0.2)
    start = classical_scaling(matrices)
    stress = [batched_mds(matrices, start, n, 0)[1] for n in (1, 2, 3, 5, 10, 20, 50, 100)]
    assert (np.diff(stress, axis=0) < 0).all()


def test_stress_is_that_of_the_points():
    """Of its disparities, which are of one iteration earlier than the points, but near the best."""
    matrices = faces()
    points, stress, _ = batched_mds(matrices, classical_scaling(matrices), 1000, 1e-12)
    for face in range(len(matrices)):
        pairs, distances = squareform(matrices[face]), pdist(points[face])
        best = IsotonicRegression().fit_transform(pairs, distances)
        kruskal = np.sqrt(((distances - best) ** 2).sum() / (distances**2).sum())
        assert kruskal <= stress[face] + 1e-12
        assert kruskal == pytest.approx(stress[face], rel=1e-3)


def test_only_the_order_of_the_dissimilarities_counts_after_the_first_iteration():
    matrices = faces()
    start = classical_scaling(matrices)
    bent = symmetric(np.exp(matrices))
    points, stress, _ = batched_mds(matrices, start, 20_000, 1e-13)
    from_bent = batched_mds(bent, start, 20_000, 1e-13)[1]
    assert np.allclose(stress, from_bent, rtol=1e-3)
    assert (stress > 1e-3).all()


def test_memory_does_not_grow_with_the_faces():
    def peak(n):
        matrices, start = np.repeat(matrix, n, 0), np.repeat(first, n, 0)
        tracemalloc.start()
        batched_mds(matrices, start, 1)
        reached = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return reached - 3 * start.nbytes  # its copy, the result and what is smaller than either

    matrix = faces(1, 60)
    first = classical_scaling(matrix)
    batched_mds(matrix, first, 1)
    assert peak(2000) < 1.2 * peak(500)


def test_without_numba_the_solver_is_the_one_that_needs_none(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    monkeypatch.delitem(sys.modules, "deepmds_keras.compiled_smacof", raising=False)
    monkeypatch.delattr(deepmds_keras, "compiled_smacof", raising=False)
    smacof_solver.cache_clear()
    try:
        assert smacof_solver() is module.smacof
    finally:
        smacof_solver.cache_clear()


def test_with_numba_the_solver_is_the_compiled_one():
    pytest.importorskip("numba", reason="numba is not installed")
    assert smacof_solver().__module__ == "deepmds_keras.compiled_smacof"
