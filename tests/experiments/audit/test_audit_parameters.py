"""Checks on parameters and times: the networks as built, and the verdicts of other numbers."""

import time
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from experiments.audit import parameter_counts as parameters
from experiments.audit.claims import judge, load_claims
from experiments.verdicts import DOES_NOT_HOLD, HOLDS, UNKNOWN, WITH_CONDITION

CLAIMS = load_claims()
BFM = pd.DataFrame(
    [("ours", "ms_per_face", 11.09), ("zhao", "ms_per_face", 0.0196), ("ours", "mse", 1e-4)],
    columns=["method", "metric", "value"],
)


def slow(milliseconds):
    def predict(views):
        time.sleep(milliseconds / 1000)

    return predict


def inputs(metrics=BFM):
    methods = {
        "linear": SimpleNamespace(n_parameters=31_320),
        "ours": SimpleNamespace(predict=slow(20), dissimilarities=slow(5)),
    }
    errors = {"ours": [1e-4, 2e-4], "linear": [3e-6, 5e-6]}
    return SimpleNamespace(
        method=methods.get,
        results={"bfm": metrics}.get,
        scores={m: SimpleNamespace(mse=np.array(mse)) for m, mse in errors.items()},
        test=SimpleNamespace(views=np.zeros((5, 72, 2))),
        run=SimpleNamespace(preset=SimpleNamespace(timed_faces=2)),
    )


@pytest.fixture(scope="module")
def measured():
    return parameters.measure(inputs())


def judged(claim, check, measured, **changed):
    return judge(CLAIMS[claim], check, {**measured, **changed})


def test_the_networks_are_counted_as_built(measured):
    assert measured["autoencoder"] == {"trainable": 24_880, "total": 25_584}
    assert measured["dissimilarity_nets"] == {
        "paper": {"trainable": 2_443, "total": 2_645},
        "released": {"trainable": 2_423, "total": 2_625},
    }
    assert measured["zhao_by_landmarks"] == {"72": 114_840, "51": 57_783}
    assert measured["mobileface_net"] == {"trainable": 900_979, "total": 907_819}
    assert measured["printed"]["ours"] == 27_505
    assert measured["errors"]["ours"] == pytest.approx(1.5e-4)


def test_below_the_bound_holds_and_above_it_does_not(measured):
    def finding(bound):
        return parameters.below_bound(measured["dissimilarity_nets"], bound)

    claimed = judged("parameters-dissimilarity", parameters.below_bound, measured)
    assert claimed.verdict == HOLDS
    assert "2,443 trainable parameters of 2,645" in claimed.evidence
    assert finding(2_443).verdict == WITH_CONDITION
    assert "5 features of the released code" in finding(2_443).condition
    assert finding(2_423).verdict == DOES_NOT_HOLD


def test_the_printed_sum_counts_what_is_not_trained(measured):
    finding = judged("parameters-ours", parameters.ours, measured)
    assert finding.verdict == WITH_CONDITION
    assert "202 numbers" in finding.condition
    assert "24,880 + 2,625" in finding.evidence
    assert "27,303" in finding.evidence


@pytest.mark.parametrize(
    ("printed", "verdict"), [(27_303, HOLDS), (27_323, HOLDS), (27_504, DOES_NOT_HOLD)]
)
def test_another_printed_sum_is_judged_by_the_trainable_one(measured, printed, verdict):
    finding = judged("parameters-ours", parameters.ours, measured, printed={"ours": printed})
    assert finding.verdict == verdict


def test_zhaos_number_is_that_of_72_landmarks(measured):
    finding = judged("parameters-zhao", parameters.zhao, measured)
    assert finding.verdict == HOLDS
    assert "57,783" in finding.evidence
    other = judged("parameters-zhao", parameters.zhao, measured, printed={"zhao": 57_783})
    assert other.verdict == DOES_NOT_HOLD


def test_mobilefaces_number_is_that_of_the_basel_model(measured):
    claim, check = "parameters-mobileface", parameters.mobileface
    assert judged(claim, check, measured).verdict == HOLDS
    all_weights = judged(claim, check, measured, printed={"mobileface": 907_819})
    assert all_weights.verdict == DOES_NOT_HOLD
    assert "900,979" in all_weights.evidence


def test_ringnet_has_more_than_the_bound(measured):
    claim, check = "parameters-ringnet", parameters.ringnet
    finding = judged(claim, check, measured)
    assert finding.verdict == HOLDS
    assert "25,006,236" in finding.evidence
    assert judged(claim, check, measured, printed={"ringnet": 26e6}).verdict == DOES_NOT_HOLD


def test_fewest_among_those_that_are_trained(measured):
    claim, check = "parameters-fewest", parameters.fewest
    finding = judged(claim, check, measured)
    assert finding.verdict == WITH_CONDITION
    assert finding.condition.startswith(
        "among the methods that are trained; Aldrian & Smith is not"
    )
    assert "31,320 and an MSE of 4 × 10⁻⁶, Deep-MDS 0.00015" in finding.evidence
    every_one = measured["printed"] | {"aldrian": 80_000.0}
    assert judged(claim, check, measured, printed=every_one).verdict == HOLDS


def test_fewer_by_a_little_is_not_far_fewer(measured):
    almost_as_few = {"trainable": 40_000, "total": 40_000}
    finding = judged("parameters-fewest", parameters.fewest, measured, mobileface_net=almost_as_few)
    assert finding.verdict == DOES_NOT_HOLD
    assert "MobileFace 40,000" in finding.evidence


def test_what_the_networks_do_not_take_is_the_embeddings_share(measured):
    assert 0.4 < measured["embedding_share"] < 0.95
    alone = SimpleNamespace(predict=slow(10), dissimilarities=slow(10))
    assert parameters.embedding_share(alone, np.zeros((2, 72, 2))) < 0.4


def test_times_are_those_of_the_table_to_two_digits(measured):
    finding = judged("inference-time", parameters.inference_time, measured, embedding_share=0.9)
    assert finding.verdict == HOLDS
    assert "Deep-MDS 11 ms, of which the embedding takes 90 %" in finding.evidence
    assert "Zhao et al. 0.02 ms" in finding.evidence


@pytest.mark.parametrize(
    ("share", "times"), [(0.9, {"ours": 1.0, "mobileface": 2.0}), (0.1, {"ours": 2.0, "zhao": 1.0})]
)
def test_a_faster_framework_or_slow_networks_do_not_show_a_slow_embedding(share, times):
    assert parameters.inference_time(times, share).verdict == DOES_NOT_HOLD


def test_without_results_there_are_no_times():
    finding = parameters.inference_time(parameters.milliseconds_of(None), 0.9)
    assert finding.verdict == UNKNOWN
    assert "reproduce-bfm" in finding.condition


def test_aldrian_is_slower_if_every_fit_of_it_is():
    times = {"ours": 8.0, "aldrian": 15.0, "aldrian_authors": 20.0}
    assert parameters.aldrian_slower(times).verdict == HOLDS
    assert parameters.aldrian_slower(times | {"aldrian": 5.0}).verdict == DOES_NOT_HOLD
    assert parameters.aldrian_slower({"ours": 8.0}).verdict == UNKNOWN
