"""The linear model: its mean, its covariance, and restriction to some vertices."""

from dataclasses import replace

import numpy as np
import pytest

from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.errors import InputError


@pytest.fixture
def model():
    rng = np.random.default_rng(0)
    return MorphableModel(
        name="toy",
        mean=rng.normal(size=(20, 3)) * 50,
        identity_basis_times_sd=rng.normal(size=(4, 20, 3)),
        triangles=np.array([[0, 1, 2]]),
        landmarks={"bfm72": np.array([3, 5])},
        expression_mean=rng.normal(size=(20, 3)),
        expression_basis=rng.normal(size=(2, 20, 3)),
        expression_names=("smile", "frown"),
        colour_mean=np.full((20, 3), 0.5),
        colour_basis_times_sd=rng.normal(size=(1, 20, 3)),
    )


def test_coefficients_add_their_components_to_the_mean(model):
    np.testing.assert_array_equal(model.shape(np.zeros((3, 4))), np.stack([model.mean] * 3))
    neutral_expression = model.mean + model.expression_mean
    np.testing.assert_allclose(model.shape(np.zeros(4), np.zeros(2)), neutral_expression)
    assert model.scaled(1) is model  # and no second basis
    face = model.shape([0, 1.0], [0, 1.0])
    added = model.identity_basis_times_sd[1] + model.expression_basis[1]
    np.testing.assert_allclose(face, neutral_expression + added)


def test_sample_covariance_tends_to_the_models(model):
    n = 40_000
    _, faces = model.sample(n, np.random.default_rng(2))
    flat = model.identity_basis_times_sd.reshape(4, -1)
    expected = flat.T @ flat
    covariance = np.cov(faces.reshape(n, -1), rowvar=False)
    # A covariance entry of n normal samples has s.d. sqrt((c_ii c_jj + c_ij^2) / n).
    variance = np.diag(expected)
    sd = np.sqrt((np.outer(variance, variance) + expected**2) / n)
    assert (np.abs(covariance - expected) < 6 * sd).all()


def test_restrict_commutes_with_shape(model):
    vertices = np.array([7, 0, 19])
    identity, expression = np.ones((2, 4)), np.ones((2, 2))
    np.testing.assert_allclose(
        model.restrict(vertices).shape(identity, expression),
        model.shape(identity, expression)[:, vertices],
    )
    assert model.restrict(vertices).n_vertices == 3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mean": np.zeros((20, 2))}, r"mean must be of shape \(20, 3\). Received \(20, 2\)"),
        ({"mean": np.full((20, 3), np.nan)}, "mean must be finite"),
        ({"identity_basis_times_sd": np.zeros((4, 19, 3))}, r"of shape \(K, 20, 3\)"),
        ({"expression_mean": np.zeros((2, 20, 3))}, r"expression_mean must be of shape \(20, 3\)"),
        ({"expression_names": ("smile",)}, "must name 2 expressions. Received 1"),
        ({"colour_basis_times_sd": np.zeros((1, 21, 3))}, "colour_basis_times_sd must be of shape"),
        ({"triangles": np.array([[0, 1, 99]])}, "number 20 vertices from 0. Received 0 to 99"),
        ({"triangles": np.array([[0.0, 1.0, 2.0]])}, r"\(T, 3\) integers. Received float64"),
        ({"triangles": np.array([0, 1, 2])}, r"\(T, 3\) integers. Received int64 \(3,\)"),
        ({"landmarks": {"bfm72": np.array([20])}}, "below 20. Received 20"),
        ({"landmarks": {"bfm72": np.array([-1])}}, "below 20. Received -1"),
    ],
)
def test_unusable_arrays_are_refused(model, change, message):
    with pytest.raises(InputError, match=f"toy: .*{message}"):
        replace(model, **change)
