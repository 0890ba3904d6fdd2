"""Claims on time: exponents of known growth, and verdicts both ways."""

from types import SimpleNamespace

import numpy as np
import pytest

from data_gen.models.registry import load_model
from experiments.audit import complexity
from experiments.verdicts import DOES_NOT_HOLD, HOLDS

NUMBERS = (120, 24)
# What each part's time is said to grow by: no clock is asked.
POWERS = {
    complexity.EMBEDDING: 2.5,
    complexity.START: 2.0,
    complexity.ITERATION: 1.5,
    complexity.NET: 1.0,
}
ALDRIAN = 1.7


def times_of(n, output, rng):
    return {part: 1e-6 * n**power for part, power in POWERS.items()}


def seconds_in_turns(calls, rounds):
    """The first round, to warm up, is far off."""
    for call in calls:
        call()
    return np.array([[5.0, 1.0], *(rounds - 1) * [[1e-6 * n**ALDRIAN for n in sorted(NUMBERS)]]])


@pytest.fixture(scope="module")
def measured():
    run = SimpleNamespace(seed=0, preset=SimpleNamespace(timed_landmarks=NUMBERS))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(complexity, "_times", times_of)
        patch.setattr(complexity, "seconds_in_turns", seconds_in_turns)
        return complexity.measure(SimpleNamespace(run=run, model=load_model("openhead")))


def test_exponent_of_a_power_is_found():
    numbers = [51, 72, 300]
    times = [7e-6 * n**2.5 for n in numbers]
    assert complexity.growth(numbers, times) == pytest.approx(2.5)


def test_every_part_is_timed_for_every_number_of_landmarks(measured):
    times = {(row["part"], row["landmarks"]): row["ms"] for row in measured["timings"]}
    given = {(part, n): 1e-3 * n**power for part, power in POWERS.items() for n in NUMBERS}
    assert times == pytest.approx(given)
    assert measured["slopes"] == pytest.approx(POWERS)


def test_iterations_are_what_the_start_leaves_of_the_embedding(measured):
    given = [(n**2.5 - n**2) / n**1.5 for n in sorted(NUMBERS)]
    assert measured["iterations"] == pytest.approx(given)


def test_parts_of_a_face_are_timed_by_the_clock():
    rng = np.random.default_rng(0)
    seen = []
    times = complexity._times(24, seen.append, rng)
    assert {*times} == {*POWERS}
    assert all(times[part] > 0 for part in POWERS if part != complexity.ITERATION)
    assert [view.shape for view in seen] == [(24, 2)]


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


def test_time_of_aldrians_fit_is_that_of_the_rounds_after_the_first(measured):
    assert measured["growth_of_others"]["aldrian"] == pytest.approx(ALDRIAN)


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
