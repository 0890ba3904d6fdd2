"""Largest eigenpairs: those of `eigh` for any symmetric matrix, and without it for faces."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform

from deepmds_keras.eigenpairs import leading_eigenpairs

pytestmark = pytest.mark.usefixtures("one_thread")


def gram(distances):
    """The matrix of classical scaling."""
    centring = np.eye(distances.shape[-1]) - 1 / distances.shape[-1]
    return -0.5 * centring @ np.square(distances) @ centring


def noisy(shape, noise, seed=0):
    error = np.triu(np.random.default_rng(seed).standard_normal((len(shape), len(shape))), 1)
    return squareform(pdist(shape)) * (1 + noise * (error + error.T))


def cloud(n_landmarks=72, seed=0):
    return np.random.default_rng(seed).standard_normal((n_landmarks, 3)) * [1, 0.8, 0.5]


def face_like(n=8, n_landmarks=72):
    return gram(np.array([noisy(cloud(n_landmarks, seed), 0.02, seed) for seed in range(n)]))


def mirrored():
    half = cloud(30)
    return np.concatenate([half, half * [-1, 1, 1], cloud(10) * [0, 1, 1]])


def of_eigh(matrices, count):
    values, vectors = np.linalg.eigh(matrices)
    return values[:, : -count - 1 : -1], vectors[..., : -count - 1 : -1]


@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize(
    "matrices",
    [
        pytest.param(face_like(), id="faces"),
        pytest.param(face_like(n_landmarks=51), id="51 landmarks"),
        pytest.param(face_like(n_landmarks=5), id="5 landmarks"),
        pytest.param(gram(squareform(pdist(cloud())))[None], id="rank 3"),
        pytest.param(gram(squareform(pdist(mirrored())))[None], id="mirror symmetry"),
        pytest.param(gram(squareform(pdist(cloud() * [1, 1, 0])))[None], id="rank 2"),
        pytest.param(gram(noisy(cloud(), 0.5))[None], id="no clear third"),
        pytest.param(-face_like(), id="most negative"),
        pytest.param(np.diag(np.arange(40.0))[None], id="evenly spaced"),
        pytest.param(1e-9 * face_like(), id="small"),
    ],
)
def test_eigenpairs_are_those_of_eigh(matrices, count):
    values, vectors = leading_eigenpairs(matrices, count)
    expected, expected_vectors = of_eigh(matrices, count)
    largest = np.abs(matrices).max()
    assert np.abs(values - expected).max() < 1e-11 * largest
    assert np.allclose(np.linalg.norm(vectors, axis=1), 1)
    scaled = np.sqrt(np.abs(values))[:, None] * vectors  # what has no value has no direction
    expected_scaled = np.sqrt(np.abs(expected))[:, None] * expected_vectors
    signs = np.sign((scaled * expected_scaled).sum(1, keepdims=True))
    assert np.abs(signs * scaled - expected_scaled).max() < 1e-6 * np.sqrt(largest)


@pytest.mark.parametrize(
    "matrix",
    [
        pytest.param(np.diag([3.0, 2, 2] + 37 * [0.01]), id="second twice"),
        pytest.param(np.diag([1.0, 1, 1] + 37 * [0.0]), id="first three times"),
    ],
)
def test_none_of_equal_eigenvalues_is_missed(matrix):
    rotation = np.linalg.qr(np.random.default_rng(0).standard_normal((40, 40)))[0]
    matrix = rotation @ matrix @ rotation.T
    values, vectors = leading_eigenpairs(matrix[None], 3)
    assert np.allclose(values, of_eigh(matrix[None], 3)[0])
    assert np.allclose(matrix @ vectors[0], values * vectors[0])
    assert np.allclose(vectors[0].T @ vectors[0], np.eye(3))


def test_matrices_beside_it_change_no_bit_of_a_result():
    matrices = np.concatenate([face_like(), gram(1 - np.eye(72))[None], -face_like(3)])
    together = leading_eigenpairs(matrices, 3)
    for i in range(len(matrices)):
        values, vectors = leading_eigenpairs(matrices[i : i + 1], 3)
        assert np.array_equal(values[0], together[0][i])
        assert np.array_equal(vectors[0], together[1][i])


@pytest.mark.parametrize("n_landmarks", [51, 72])
def test_faces_need_no_full_decomposition(n_landmarks, monkeypatch):
    sizes, eigh = [], np.linalg.eigh
    monkeypatch.setattr(np.linalg, "eigh", lambda a: sizes.append(a.shape[-1]) or eigh(a))
    leading_eigenpairs(face_like(n_landmarks=n_landmarks), 3)
    assert sizes and max(sizes) < 20
