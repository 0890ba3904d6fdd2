"""Claims on time: how that of a prediction grows with the number of landmarks."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from deepmds_keras.embedding import classical_scaling, embed, pairwise_distances
from deepmds_keras.normalisation import normalise
from deepmds_keras.proximities import pair_features
from experiments.audit.evidence import Inputs
from experiments.audit.findings import Finding, does_not_hold, holds
from experiments.running import single_threaded
from experiments.scoring.numbers import factor
from experiments.streams import Stream
from experiments.timing import seconds_in_turns

# An exponent is the slope of a straight line through a few measured times.
_TOLERANCE = 0.2
_ROUNDS = 9  # in each of which everything is timed once, on new points
_NOISE = 0.02  # of a distance, about that of learnt dissimilarities
# The time of an iteration is that of the further ones, so that the start does not count.
_FEW_ITERATIONS, _MANY_ITERATIONS = 10, 30
EMBEDDING, START, ITERATION = "embedding", "classical start", "one SMACOF iteration"
NET = "dissimilarity net"


def measure(inputs: Inputs) -> dict:
    """Median times of a face by the number of landmarks: `timings`, and exponents of the growth.

    The embedding is that of noisy distances of random 3D points, on one thread; TensorFlow uses as
    many threads as it likes.
    """
    from deepmds_keras.networks import build_dissimilarity_net, forward

    numbers = sorted(inputs.run.preset.timed_landmarks)
    rng = np.random.default_rng([inputs.run.seed, Stream.AUDIT_COMPLEXITY])
    net = build_dissimilarity_net()  # whose time does not depend on its weights

    def output(views):
        return forward(net, pair_features(views))

    with single_threaded():
        # The first round is to warm up.
        rounds = [[_times(n, output, rng) for n in numbers] for _ in range(_ROUNDS + 1)][1:]
    by_part = {
        part: [float(np.median([times[k][part] for times in rounds])) for k in range(len(numbers))]
        for part in (EMBEDDING, START, ITERATION, NET)
    }
    whole = np.add(by_part[EMBEDDING], by_part[NET])
    iterations = np.subtract(by_part[EMBEDDING], by_part[START]) / by_part[ITERATION]
    return {
        "growth_of_others": growth_of_others(inputs, numbers, rng),
        "landmarks": numbers,
        "whole_ms": (1000 * whole).tolist(),
        "iterations": iterations.tolist(),
        "slopes": {part: growth(numbers, times) for part, times in by_part.items()},
        "whole_slope": growth(numbers, whole),
        "timings": [
            {"landmarks": n, "part": part, "ms": 1000 * seconds}
            for part, times in by_part.items()
            for n, seconds in zip(numbers, times, strict=True)
        ],
    }


def cubic_time(
    whole_slope: float,
    slopes: Mapping[str, float],
    iterations: Sequence[float],
    landmarks: Sequence[int],
    exponent: float,
) -> Finding:
    """Does the time of a prediction grow no faster than the claimed power?"""
    evidence = (
        f"From {landmarks[0]} to {landmarks[-1]} landmarks the time of the dissimilarity net and "
        f"the embedding of a face grows as the number to the power {whole_slope:.2f}. Alone the "
        f"net has the power {slopes[NET]:.2f}, the embedding {slopes[EMBEDDING]:.2f}, its "
        f"classical start {slopes[START]:.2f} and one SMACOF iteration "
        f"{slopes[ITERATION]:.2f}. The iterations needed are about {iterations[0]:.0f} at first "
        f"and {iterations[-1]:.0f} at last."
    )
    if whole_slope > exponent + _TOLERANCE:
        return does_not_hold(evidence)
    return holds(f"{evidence} The claim is an upper bound.")


def others_as_printed(
    growth_of_others: Mapping[str, float], landmarks: Sequence[int], zhao: float, aldrian: float
) -> Finding:
    """Have the compared methods the printed complexities?"""
    own = growth_of_others
    evidence = (
        f"From {landmarks[0]} to {landmarks[-1]} landmarks the parameters of Zhao's net grow as "
        f"the number to the power {own['zhao']:.2f} (printed {zhao:g}): its layers are as wide as "
        f"the view, and a prediction uses each parameter once. The time of Aldrian's fit grows as "
        f"{own['aldrian']:.2f} (printed {aldrian:g}). The networks of MobileFace and RingNet see "
        "an image, whose size the number does not change."
    )
    if own["zhao"] > zhao + _TOLERANCE or own["aldrian"] > aldrian + _TOLERANCE:
        return does_not_hold(evidence)
    return holds(f"{evidence} The claims are upper bounds.")


def many_landmarks(landmarks: Sequence[int], whole_ms: Sequence[float]) -> Finding:
    """Does a prediction take longer with more landmarks?"""
    first, last = whole_ms[0], whole_ms[-1]
    evidence = (
        f"The dissimilarity net and the embedding of a face take {_two_digits(first)} ms with "
        f"{landmarks[0]} landmarks and {_two_digits(last)} ms with {landmarks[-1]}, "
        f"{factor(last / first)} times as long."
    )
    return holds(evidence) if last > first else does_not_hold(evidence)


def growth_of_others(
    inputs: Inputs, numbers: Sequence[int], rng: np.random.Generator
) -> dict[str, float]:
    """Exponents of the growth of Zhao's parameters, and of the time of Aldrian's fit to a face."""
    from deepmds_keras.baselines.aldrian import Aldrian
    from deepmds_keras.baselines.zhao import build_zhao_net

    fits = []
    for n in numbers:
        part = inputs.model.restrict(rng.choice(inputs.model.n_vertices, n, replace=False))
        fit = Aldrian(part.mean, part.identity_basis_times_sd)
        view = normalise(part.mean[None, :, :2])
        fits.append(lambda fit=fit, view=view: fit.predict(view))
    with single_threaded():
        times = np.median(seconds_in_turns(fits, _ROUNDS + 1)[1:], axis=0)
    parameters = [build_zhao_net(n).count_params() for n in numbers]
    return {"zhao": growth(numbers, parameters), "aldrian": growth(numbers, times)}


def growth(numbers: Sequence[int], times: Sequence[float]) -> float:
    """Exponent of the power of the number that fits the times best, in their logarithms."""
    return float(np.polyfit(np.log(numbers), np.log(times), 1)[0])


def _times(n_landmarks, output, rng) -> dict[str, float]:
    points = rng.standard_normal((n_landmarks, 3))
    distances = pairwise_distances(points)
    noise = np.triu(rng.normal(0, _NOISE, distances.shape), 1)
    noisy = distances * (1 + noise + noise.T)
    few = _seconds(lambda: embed(noisy, max_iter=_FEW_ITERATIONS, eps=0))
    many = _seconds(lambda: embed(noisy, max_iter=_MANY_ITERATIONS, eps=0))
    return {
        EMBEDDING: _seconds(lambda: embed(noisy)),
        START: _seconds(lambda: classical_scaling(noisy[None])),
        ITERATION: (many - few) / (_MANY_ITERATIONS - _FEW_ITERATIONS),
        NET: _seconds(lambda: output(points[:, :2])),
    }


def _seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def _two_digits(value: float) -> str:
    return f"{float(f'{value:.2g}'):g}"
