"""The compiled solver takes the steps of scikit-learn and stops at the same one."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform
from sklearn.isotonic import IsotonicRegression

from deepmds_keras.embedding import classical_scaling, sklearn_mds

pytest.importorskip("numba", reason="numba is not installed")
from deepmds_keras.compiled_mds import compiled_mds  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_thread")


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


def compare(matrices, start, *limits):
    for matrix, first in zip(matrices, start, strict=True):
        points, stress, n_iter = compiled_mds(matrix, first, *limits)
        expected, expected_stress, expected_n_iter = sklearn_mds(matrix, first, *limits)
        assert n_iter == expected_n_iter
        assert stress == pytest.approx(expected_stress, rel=1e-9, abs=1e-12)
        assert np.abs(points - expected).max() < 1e-9 * np.abs(expected).max()


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
    compare(matrices, classical_scaling(matrices))


@pytest.mark.parametrize("n_components", [1, 2, 5])
@pytest.mark.parametrize("limits", [(1, 1e-6), (2, 1e-6), (300, 1e-3), (100, 1e-9)])
def test_dimensions_and_limits_are_those_of_scikit_learn(n_components, limits):
    compare(faces(), np.random.default_rng(3).standard_normal((3, 30, n_components)), *limits)


def test_landmarks_that_start_at_one_place_are_parted_as_by_scikit_learn():
    matrices, start = faces(2), np.random.default_rng(4).standard_normal((2, 30, 3))
    start[:, 5] = start[:, 6]
    compare(matrices, start)


def test_ties_but_for_rounding_are_ties():
    tied = symmetric(0.5 + np.round(faces(1, noise=0.1), 1) / 20)[0]
    rounding = np.random.default_rng(5).integers(0, 20, tied.shape) * 2.0**-53
    matrix = symmetric(tied + rounding)
    smallest, groups = 0.0, {}
    for value in np.unique(matrix):
        smallest = value if value - smallest >= 1e-15 else smallest  # as scikit-learn has it
        groups[value] = smallest
    grouped = np.vectorize(groups.get)(matrix)
    start = classical_scaling(tied[None])[0]
    points = compiled_mds(matrix, start)[0]
    assert np.allclose(points, compiled_mds(grouped, start)[0], atol=1e-9)
    assert not np.allclose(points, compiled_mds(tied, start)[0], atol=1e-6)


def test_arrays_that_must_not_be_written_are_not():
    matrix, start = faces()[0], classical_scaling(faces())[0]
    expected = compiled_mds(matrix.copy(), start.copy())
    matrix.flags.writeable = start.flags.writeable = False
    assert np.array_equal(compiled_mds(matrix, start)[0], expected[0])


def test_stress_falls_with_every_iteration():
    matrix, start = faces(noise=0.2)[0], classical_scaling(faces(noise=0.2))[0]
    stress = [compiled_mds(matrix, start, n, 0)[1] for n in (1, 2, 3, 5, 10, 20, 50, 100)]
    assert (np.diff(stress) < 0).all()


@pytest.mark.parametrize("face", range(3))
def test_stress_is_that_of_the_points(face):
    """Of its disparities, which are of one iteration earlier than the points, but near the best."""
    matrix = faces()[face]
    points, stress, _ = compiled_mds(matrix, classical_scaling(matrix[None])[0], 1000, 1e-12)
    distances = pdist(points)
    best = IsotonicRegression().fit_transform(squareform(matrix), distances)
    kruskal = np.sqrt(((distances - best) ** 2).sum() / (distances**2).sum())
    assert kruskal <= stress + 1e-12
    assert kruskal == pytest.approx(stress, rel=1e-3)


@pytest.mark.parametrize("face", range(3))
def test_only_the_order_of_the_dissimilarities_counts_after_the_first_iteration(face):
    matrix = faces()[face]
    start = classical_scaling(matrix[None])[0]
    stress, from_bent = (
        compiled_mds(each, start, 20_000, 1e-13)[1] for each in (matrix, symmetric(np.exp(matrix)))
    )
    assert stress == pytest.approx(from_bent, rel=1e-3)
    assert stress > 1e-3
