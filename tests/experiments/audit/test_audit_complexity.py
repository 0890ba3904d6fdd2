"""Claims on time: exponents of known growth, and verdicts both ways."""

from types import SimpleNamespace

import numpy as np
import pytest

from data_gen.models.registry import load_model
from experiments.audit import complexity
from experiments.verdicts import DOES_NOT_HOLD, HOLDS

NUMBERS = (120, 24)


@pytest.fixture(scope="module")
def measured():
    preset = SimpleNamespace(timed_landmarks=NUMBERS)
    run = SimpleNamespace(seed=0, preset=preset)
    return complexity.measure(SimpleNamespace(run=run, model=load_model("openhead")))


def test_exponent_of_a_power_is_found():
    numbers = [51, 72, 300]
    times = [7e-6 * n**2.5 for n in numbers]
    assert complexity.growth(numbers, times) == pytest.approx(2.5)


def test_every_part_is_timed_for_every_number_of_landmarks(measured):
    times = {(row["part"], row["landmarks"]): row["ms"] for row in measured["timings"]}
    assert {n for _, n in times} == set(NUMBERS)
    assert len(times) == 4 * len(NUMBERS)
    for n in NUMBERS:
        # The start is part of the embedding, which has an iteration at least.
        assert 0 < times["classical start", n] < times["embedding", n]
        assert 0 < times["one SMACOF iteration", n] < times["embedding", n]


def test_whole_is_net_and_embedding(measured):
    times = {(row["part"], row["landmarks"]): row["ms"] for row in measured["timings"]}
    assert measured["landmarks"] == sorted(NUMBERS)
    whole = [times["embedding", n] + times["dissimilarity net", n] for n in sorted(NUMBERS)]
    np.testing.assert_allclose(measured["whole_ms"], whole)
    assert measured["whole_slope"] == pytest.approx(np.log(whole[1] / whole[0]) / np.log(5))


@pytest.mark.parametrize(
    ("slope", "verdict"), [(1.4, HOLDS), (3.0, HOLDS), (3.1, HOLDS), (3.6, DOES_NOT_HOLD)]
)
def test_cubic_time_is_a_bound_from_above(slope, verdict):
    slopes = dict.fromkeys(
        ("embedding", "classical start", "one SMACOF iteration", "dissimilarity net"), 1.23
    )
    finding = complexity.cubic_time(slope, slopes, [20.0, 4.0], [51, 478], exponent=3)
    assert finding.verdict == verdict
    assert f"{slope:.2f}" in finding.evidence
    assert "about 20 at first and 4 at last" in finding.evidence


def test_zhaos_net_grows_as_wide_as_the_view(measured):
    """Its square matrices as the number squared, its other weights as the number."""
    found = measured["growth_of_others"]
    assert 1.9 < found["zhao"] < 2
    assert 0 < found["aldrian"] < 3


@pytest.mark.parametrize(
    ("zhao", "aldrian", "verdict"),
    [(0.0, 3.0, HOLDS), (2.0, 3.0, DOES_NOT_HOLD), (0.1, 4.5, DOES_NOT_HOLD)],
)
def test_printed_complexities_are_bounds_from_above(zhao, aldrian, verdict):
    found = {"zhao": zhao, "aldrian": aldrian}
    assert complexity.others_as_printed(found, [51, 478], zhao=0, aldrian=4).verdict == verdict


def test_more_landmarks_are_heavier_if_they_take_longer():
    finding = complexity.many_landmarks([51, 478], [12.3, 154.0])
    assert finding.verdict == HOLDS
    assert "12 ms" in finding.evidence
    assert "150 ms" in finding.evidence
    assert "12.52 times" in finding.evidence
    assert complexity.many_landmarks([51, 478], [12.0, 11.0]).verdict == DOES_NOT_HOLD
