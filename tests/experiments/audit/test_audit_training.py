"""Claims on training: each check gives the other verdict where the claim is false."""

import numpy as np
import pytest

from experiments.audit import mini_batches as training
from experiments.verdicts import DOES_NOT_HOLD, HOLDS, UNKNOWN, WITH_CONDITION

SEEDS = np.array([1.0, 1.2, 0.9, 1.1, 1.05])
PRINTED = {"printed_mse": 1.4e-4, "printed_std": 5e-7, "subset_size": 500}


def variant(mse, inference=1.0, train=1.0):
    return {
        "mse": [*(mse * SEEDS)],
        "loss_inference": [*(inference * SEEDS)],
        "loss_train": [*(train * SEEDS)],
    }


def test_better_shapes_from_same_face_batches_let_the_claim_hold():
    found = training.same_face_batches({"same_face": variant(1e-4), "shuffled": variant(2e-4)})
    assert found.verdict == HOLDS
    assert "1.05 ± 0.112 against 2.1 ± 0.224" in found.evidence


def test_worse_shapes_from_same_face_batches_do_not():
    found = training.same_face_batches({"same_face": variant(2e-4), "shuffled": variant(1e-4)})
    assert found.verdict == DOES_NOT_HOLD


def test_a_difference_within_the_luck_of_seeds_is_none():
    rng = np.random.default_rng(0)
    a, b = variant(1e-4), variant(1.01e-4)
    b["mse"] = [*rng.permutation(b["mse"])]
    assert training.same_face_batches({"same_face": a, "shuffled": b}).verdict == DOES_NOT_HOLD


def test_a_better_loss_alone_is_a_condition():
    found = training.same_face_batches(
        {"same_face": variant(1e-4, train=0.5), "shuffled": variant(1e-4)}
    )
    assert found.verdict == WITH_CONDITION
    assert found.condition.startswith("in the loss while it trains at the paper's constant")


def test_the_decayed_rate_is_the_other_reading():
    constant = {"same_face": variant(1e-4), "shuffled": variant(1e-4)}
    decayed = {"same_face_stable": variant(1e-4), "shuffled_stable": variant(2e-4)}
    found = training.same_face_batches(constant | decayed)
    assert (found.verdict, "at a decayed one" in found.condition) == (WITH_CONDITION, True)


@pytest.mark.parametrize(("without", "verdict"), [(2e-4, HOLDS), (0.5e-4, DOES_NOT_HOLD)])
def test_the_short_connection_is_judged_by_what_the_net_is_without_it(without, verdict):
    ablation = {"same_face": variant(1e-4), "no_short_connection": variant(without)}
    assert training.short_connection(ablation).verdict == verdict


DEPTHS = ("two_layers_stable", "three_layers_stable", "five_layers_stable", "eight_layers_stable")


@pytest.mark.parametrize(
    ("errors", "verdict"),
    [
        ((2e-4, 2e-4, 2e-4, 2e-4), HOLDS),
        ((2e-4, 0.5e-4, 2e-4, 2e-4), DOES_NOT_HOLD),
        ((2e-4, 1e-4, 2e-4, 2e-4), WITH_CONDITION),
    ],
)
def test_five_layers_are_best_if_every_other_depth_is_worse(errors, verdict):
    ablation = {name: variant(own) for name, own in zip(DEPTHS, errors, strict=True)}
    assert training.five_layers(ablation | {"same_face_stable": variant(1e-4)}).verdict == verdict
    assert training.five_layers({"same_face_stable": variant(1e-4)}).verdict == UNKNOWN


def curve(fewer, all_faces):
    errors = {"ours_stable": (fewer, all_faces), "ours": (2e-4, 1e-4), "linear": (3e-6, 3e-6),
              "mean_shape": (6e-5, 6e-5)}  # fmt: skip
    return [
        {"method": method, "value": n, "mse": mse}
        for method, both in errors.items()
        for n, mse in zip((500, 20_000), both, strict=True)
    ]


def test_all_faces_are_needed_where_fewer_err_more():
    assert training.enough_faces(curve(4e-4, 1e-4)).verdict == HOLDS
    found = training.enough_faces(curve(1.2e-4, 1e-4))
    assert found.verdict == DOES_NOT_HOLD
    assert "With 500 faces the error is 1.20 times that with 20,000" in found.evidence


def test_the_printed_spread_holds_if_trainings_differ_no_more():
    def known(spread, by_face):
        by_seed = {"ours": [*(1.4e-4 + spread * np.array([-1, 0, 1]))]}
        mse_by_face = {"mean": 1.4e-4, "std": by_face}
        return training.known_to(by_seed, mse_by_face, **PRINTED)

    assert known(4e-7, 1e-5).verdict == HOLDS
    assert known(5e-5, 1e-5).verdict == WITH_CONDITION
    found = known(5e-5, 1e-4)
    assert found.verdict == DOES_NOT_HOLD
    assert "From 3 seeds the MSE is 1.4 ± 0.5 (Deep-MDS, at worst 2.11 times" in found.evidence


def test_what_was_not_trained_cannot_be_checked():
    unchecked = (
        training.same_face_batches(None),
        training.short_connection(None),
        training.enough_faces(None),
        training.known_to(None, {"mean": 1e-4, "std": 1e-5}, **PRINTED),
    )
    assert {found.verdict for found in unchecked} == {UNKNOWN}
    assert [f.condition for f in unchecked] == ["`make ablation`"] * 3 + ["`make seeds`"]
