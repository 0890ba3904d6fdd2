"""Claims on dissimilarities: measured where the answer is known, and judged both ways."""

from types import SimpleNamespace

import numpy as np
import pytest

from deepmds_keras.embedding import pairwise_distances
from deepmds_keras.normalisation import normalise
from experiments.audit import dissimilarity
from experiments.verdicts import DOES_NOT_HOLD, HOLDS, WITH_CONDITION

N, L = 4, 24


class Oracle:
    """Knows the faces; its net gives the distances in the frontal view."""

    variant = "paper"

    def __init__(self, shapes):
        self.shapes = shapes

    def frontalise(self, views):
        return self.shapes[..., :2]

    def dissimilarities(self, views):
        return pairwise_distances(self.shapes)

    def predict(self, views):
        return np.broadcast_to(self.shapes.mean(0), self.shapes.shape)

    @staticmethod
    def dissimilarity_net_(features, training):
        return np.linalg.norm(features[:, :2], axis=1, keepdims=True)


@pytest.fixture(scope="module")
def inputs():
    shapes = normalise(np.random.default_rng(0).normal(0, (3, 2, 1), (N, L, 3)))
    faces = SimpleNamespace(views=shapes[..., :2], shapes=shapes)
    return SimpleNamespace(
        run=SimpleNamespace(seed=0),
        test=faces,
        audited=np.arange(N),
        method=lambda _: Oracle(shapes),
    )


@pytest.fixture(scope="module")
def measured(inputs):
    return dissimilarity.measure(inputs)


def judged(measured, check, **changed):
    names = check.__code__.co_varnames[: check.__code__.co_argcount]
    return check(**{name: (measured | changed)[name] for name in names})


def test_features_of_both_orders_give_one_output(measured):
    assert measured["asymmetry"] == 0
    assert judged(measured, dissimilarity.symmetric).verdict == HOLDS


def test_an_output_that_depends_on_the_order_is_found(inputs, monkeypatch):
    def signed(first, second, variant):
        return np.concatenate([np.maximum(first - second, 0), second], axis=-1)

    monkeypatch.setattr(dissimilarity, "proximities", signed)
    measured = dissimilarity.measure(inputs)
    assert measured["asymmetry"] > 0.1
    finding = judged(measured, dissimilarity.symmetric)
    assert finding.verdict == DOES_NOT_HOLD
    assert f"{measured['asymmetry']:.2g}" in finding.evidence


def test_true_distances_give_the_shape_but_for_what_they_do_not_tell(measured):
    finding = judged(measured, dissimilarity.exact_distances)
    assert finding.verdict == WITH_CONDITION
    assert "place" in finding.condition
    own = measured["from_exact"]
    assert own["mean_shape"] > 1e-3 > 1e-20 > own["classical"]
    assert ("mirror image" in finding.condition) == (own["mirrored"] > 0)
    assert (own["unreflected"] > 1e-3) == (own["mirrored"] > 0)


def test_shapes_that_differ_from_the_truth_refute_exact_distances(measured):
    own = measured["from_exact"]
    refuted = judged(measured, dissimilarity.exact_distances, from_exact=own | {"classical": 2e-5})
    assert refuted.verdict == DOES_NOT_HOLD
    assert "2 × 10⁻⁵" in refuted.evidence
    half = judged(measured, dissimilarity.exact_distances, from_exact=own | {"non_metric": 3e-5})
    assert half.verdict == WITH_CONDITION
    assert "classical" in half.condition


def test_spectra_count_the_dimensions(measured):
    spectra = measured["spectra"]
    for name, n_dimensions in (("true 3D distances", 3), ("frontal view", 2)):
        shares = np.array(spectra[name])
        assert (shares[:n_dimensions] > 0.01).all()
        np.testing.assert_allclose(shares[n_dimensions:], 0, atol=1e-12)
        np.testing.assert_allclose(shares.sum(), 1)
    np.testing.assert_allclose(
        spectra["learnt dissimilarities"], spectra["true 3D distances"], atol=1e-9
    )
    assert measured["matrix_ranks"] == dict.fromkeys(spectra, L)
    effective = measured["effective_numbers"]
    assert 1 < effective["frontal view"] < 2
    assert effective["frontal view"] < effective["true 3D distances"] < 3


def test_eigenvalues_of_all_but_distances_keep_their_sign():
    matrix = np.ones((1, 4, 4)) - np.eye(4)
    matrix[0, 0, 1] = matrix[0, 1, 0] = 3  # further than by way of any other point
    shares = dissimilarity.eigenvalues(matrix)[0]
    assert shares[0] > 0 > shares.min()
    np.testing.assert_allclose(np.abs(shares).sum(), 1)
    assert (np.diff(np.abs(shares)) <= 0).all()


def test_a_third_component_that_lifts_holds(measured):
    finding = judged(measured, dissimilarity.rank_above_two)
    assert finding.verdict == HOLDS
    assert measured["lifted"]["three"] < 1e-20
    third = 100 * measured["spectra"]["learnt dissimilarities"][2]
    assert f"{third:.2g} %" in finding.evidence


def test_dissimilarities_of_rank_two_are_not_lifted(measured):
    spectra = measured["spectra"]
    flat = spectra | {"learnt dissimilarities": spectra["frontal view"]}
    assert judged(measured, dissimilarity.rank_above_two, spectra=flat).verdict == DOES_NOT_HOLD
    # One of many of the same size is no third dimension, nor is a negative one.
    for shares in ([0.5, 0.3, 0.02, 0.015], [0.5, 0.3, -0.1, 0.01]):
        own = spectra | {"learnt dissimilarities": shares}
        assert judged(measured, dissimilarity.rank_above_two, spectra=own).verdict == DOES_NOT_HOLD
    useless = measured["lifted"] | {"two": 0.002, "three": 0.0015}
    finding = judged(measured, dissimilarity.rank_above_two, lifted=useless)
    assert finding.verdict == DOES_NOT_HOLD
    assert "0.0015" in finding.evidence


def test_distances_of_d_dimensions_have_rank_d(measured):
    for row in measured["ranks"]:
        d = row["dimensions"]
        assert (row["centred"], row["squared"], row["distances"]) == (d, d + 2, L)
    assert measured["flat_rank"] == 2
    assert measured["few_points_rank"] == 4
    assert measured["residual"] < 1e-20
    assert judged(measured, dissimilarity.distance_rank).verdict == DOES_NOT_HOLD


@pytest.mark.parametrize("matrix", ["centred", "squared", "distances"])
def test_rank_of_one_less_than_the_dimensions_would_hold(measured, matrix):
    ranks = [row | {matrix: row["dimensions"] - 1} for row in measured["ranks"]]
    finding = judged(measured, dissimilarity.distance_rank, ranks=ranks)
    assert finding.verdict == HOLDS
    assert "0, 1, 2, 3, 4, 5 and 2" in finding.evidence


def test_distances_in_the_view_give_shapes_without_depth(measured):
    for own in measured["classes"].values():
        assert max(own["classical"], own["non_metric"]) < 1e-9
        assert own["flat"] > 0.02
        # To the rounding of the net's features.
        np.testing.assert_allclose(own["learnt"], own["flat"], rtol=1e-3)


def classes(learnt, exact=1e-30):
    own = {"classical": exact, "non_metric": exact, "learnt": learnt, "flat": 0.3}
    faces = {"classical": 1e-30, "non_metric": 1e-30, "learnt": 0.01, "flat": 0.1}
    return {"faces": faces, "cubes": own}


def test_classes_of_shapes_are_judged_by_mds_and_then_by_the_net():
    of_mds = dissimilarity.shape_classes(classes(0.4, exact=0.07))
    assert of_mds.verdict == HOLDS
    assert "0.07" in of_mds.evidence
    of_net = dissimilarity.shape_classes(classes(0.4))
    assert of_net.verdict == WITH_CONDITION
    assert "learnt" in of_net.condition
    assert "40 % on cubes (30 %)" in of_net.evidence
    assert dissimilarity.shape_classes(classes(0.01)).verdict == DOES_NOT_HOLD
