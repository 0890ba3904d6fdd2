"""Each part of the method in the released way and in ours, on one core."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from data_gen.datasets.dataset import make_dataset
from deepmds_keras.embedding import compiled_solver
from deepmds_keras.pipeline import DeepMDS
from deepmds_keras.proximities import pair_features
from experiments.bench import released_code as released
from experiments.bench.measurements import BATCHED, RELEASED, SKLEARN, Implementation
from experiments.bench.workload import (
    SCHEME,
    Workload,
    embed_all,
    predict_all,
)

OURS, LIFTING = "ours", "lifting"
DATA, FEATURES, PREDICTION = "data generation", "pair features", "prediction"
EMBEDDING, END_TO_END, ONE_BY_ONE = "embedding", "end to end", "one face at a time"
_NO_NUMBA = "numba is not installed"
_NOTES = {
    (DATA, RELEASED): "all vertices of one face at a time",
    (DATA, OURS): "only the landmarks, 4,096 faces at a time",
    (FEATURES, RELEASED): "two nested loops over all ordered pairs",
    (FEATURES, OURS): "every pair once",
    (PREDICTION, RELEASED): "one Keras predict a face and network; pair features of all at once",
    (PREDICTION, OURS): "64 faces at a time, with their pair features",
    (EMBEDDING, RELEASED): "scikit-learn, four random starts",
    (EMBEDDING, SKLEARN): "scikit-learn, classical start",
    (EMBEDDING, BATCHED): "compiled by numba",
    (END_TO_END, RELEASED): "loops over pairs, one predict a face and network, four random starts",
    (END_TO_END, SKLEARN): "DeepMDS.predict, embedded by scikit-learn",
    (END_TO_END, BATCHED): "DeepMDS.predict, embedded by the batched solver",
    (END_TO_END, LIFTING): "another method: LandmarkLifter.predict",
    (ONE_BY_ONE, SKLEARN): "one call for each face",
    (ONE_BY_ONE, BATCHED): "one call for each face",
    (ONE_BY_ONE, LIFTING): "another method; one call for each face",
}


def comparisons(workload: Workload) -> Iterator[list[Implementation]]:
    """The ways of each part that are timed in turn."""
    preset = workload.run.preset
    n, few = preset.bench_faces, preset.bench_released_faces
    views, lifter = workload.first_views(n), workload.lifter
    some = max(1, n // 5)
    for part, own in (
        (DATA, [(RELEASED, make_faces(workload, RELEASED, few), few),
                (OURS, make_faces(workload, OURS, n), n)]),
        (FEATURES, [(RELEASED, lambda: _loops(workload, few), few),
                    (OURS, lambda: pair_features(views), n)]),
        (PREDICTION, [(RELEASED, lambda: _predict(workload, few), few),
                      (OURS, lambda: predict_all(workload.networks, views), n)]),
        (EMBEDDING, [(RELEASED, lambda: released.embed(workload.matrices[:few]), few),
                     (SKLEARN, lambda: embed_all(workload.matrices, some, "sklearn"), some),
                     (BATCHED, compiled(lambda: embed_all(workload.matrices, n, "batched")), n)]),
        (END_TO_END, [(RELEASED, lambda: released.shapes(workload.networks, views[:few]), few),
                      (SKLEARN, lambda: end_to_end(workload, some, "sklearn"), some),
                      (BATCHED, compiled(lambda: end_to_end(workload, n, "batched")), n),
                      (LIFTING, lambda: lifter.predict(views), n)]),
    ):  # fmt: skip
        yield [timed(part, name, call, workload.n_landmarks, faces) for name, call, faces in own]


def one_by_one(workload: Workload) -> Iterator[list[Implementation]]:
    """Predictions of one face at a time, as from a camera."""
    n = max(1, workload.run.preset.bench_faces // 5)
    views, lifter = workload.first_views(n), workload.lifter

    def deep_mds(solver: str) -> list[np.ndarray]:
        networks = workload.networks.set_params(solver=solver, n_jobs=1)
        return [networks.predict(view) for view in views]

    yield [
        timed(ONE_BY_ONE, name, call, workload.n_landmarks, n)
        for name, call in (
            (SKLEARN, lambda: deep_mds(SKLEARN)),
            (BATCHED, compiled(lambda: deep_mds(BATCHED))),
            (LIFTING, lambda: [lifter.predict(view) for view in views]),
        )
    ]


def timed(
    part: str,
    name: str,
    call: Callable[[], object] | None,
    n_landmarks: int,
    n_faces: int,
    jobs: int = 1,
) -> Implementation:
    """With its note, or why it cannot be timed."""
    words = _NOTES[part, name] if call is not None else _NO_NUMBA
    return Implementation(part, name, call, n_landmarks, n_faces, jobs, words)


def compiled(call: Callable[[], object]) -> Callable[[], object] | None:
    """The call, or None where the batched solver is not compiled."""
    return call if compiled_solver() else None


def make_faces(workload: Workload, name: str, n: int) -> Callable[[], object]:
    """Data generation in one of its two ways, with the same random numbers in every call."""
    model, protocol = workload.model, workload.run.protocol
    if name == RELEASED:
        return lambda: released.make_faces(model, n, workload.rng(1), SCHEME, protocol)
    return lambda: make_dataset(model, n, workload.rng(1), scheme=SCHEME, protocol=protocol)


def end_to_end(workload: Workload, n: int, solver: str, jobs: int = 1) -> np.ndarray:
    """Shapes of n views."""
    networks: DeepMDS = workload.networks.set_params(solver=solver, n_jobs=jobs)
    return networks.predict(workload.first_views(n))


def _loops(workload, n):
    pairs = released.all_pairs(workload.n_landmarks)
    for view in workload.first_views(n):
        released.pair_features(view, workload.networks.variant, pairs)


def _predict(workload, n):
    return released.predict(workload.networks, workload.first_views(n), loops=False)
