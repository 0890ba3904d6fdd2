"""Growth of the time with the number of faces, of landmarks and of processes."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from joblib import effective_n_jobs

from deepmds_keras.io.errors import InputError
from deepmds_keras.networks import build_autoencoder
from deepmds_keras.normalisation import normalise
from deepmds_keras.proximities import pair_features
from experiments.bench import parts
from experiments.bench import released_code as released
from experiments.bench.measurements import BATCHED, RELEASED, SKLEARN, Implementation
from experiments.bench.parts import DATA, EMBEDDING, END_TO_END, FEATURES, OURS, PREDICTION
from experiments.bench.workload import Workload, dissimilarities, embed_all, predict_all

_LANDMARKS_OF_ALL = 20_000  # faces times landmarks of a row
_UNTRAINED = "; autoencoder untrained, since none is of these landmarks"


def with_faces(workload: Workload) -> Iterator[list[Implementation]]:
    """Growing numbers of faces, ours; scikit-learn's solver as far as it is not left out."""
    matrices, networks = workload.matrices, workload.networks
    for n in workload.run.preset.bench_many_faces:
        views = workload.first_views(n)
        for part, own in (
            (DATA, {OURS: parts.make_faces(workload, OURS, n)}),
            (PREDICTION, {OURS: partial(predict_all, networks, views)}),
            (EMBEDDING, {SKLEARN: partial(embed_all, matrices, n, SKLEARN),
                         BATCHED: parts.compiled(partial(embed_all, matrices, n, BATCHED))}),
            (END_TO_END, {SKLEARN: partial(parts.end_to_end, workload, n, SKLEARN),
                          BATCHED: parts.compiled(
                              partial(parts.end_to_end, workload, n, BATCHED))}),
        ):  # fmt: skip
            yield [
                parts.timed(part, name, call, workload.n_landmarks, n) for name, call in own.items()
            ]


def with_jobs(workload: Workload) -> Iterator[list[Implementation]]:
    """1, 2, 4, … processes up to all that the run may use, for both solvers."""
    cores, n = effective_n_jobs(workload.run.jobs), 2 * workload.run.preset.bench_faces
    numbers = sorted({2**k for k in range(cores.bit_length())} | {cores})
    for jobs in numbers if cores > 1 else ():
        for part in (EMBEDDING, END_TO_END):
            own = []
            for name, faces in ((SKLEARN, max(1, n // 5)), (BATCHED, n)):
                of, on = {
                    EMBEDDING: (embed_all, workload.matrices),
                    END_TO_END: (parts.end_to_end, workload),
                }[part]
                call = partial(of, on, faces, name, jobs)
                call = call if name == SKLEARN else parts.compiled(call)
                own.append(parts.timed(part, name, call, workload.n_landmarks, faces, jobs))
            yield own


def with_landmarks(workload: Workload) -> Iterator[list[Implementation]]:
    """Numbers of landmarks: those of the schemes, or vertices drawn at random."""
    for n_landmarks in workload.run.preset.timed_landmarks:
        yield from _of_landmarks(workload, frontal_views(workload, n_landmarks))


def frontal_views(workload: Workload, n_landmarks: int) -> np.ndarray:
    """True frontal views `(n, L, 2)` of random faces with that many landmarks.

    Raises:
        InputError: The face model has fewer vertices.
    """
    model, rng = workload.model, workload.rng(2, n_landmarks)
    schemes = {len(own): own for name, own in model.landmarks.items() if name != "ibug68"}
    vertices = schemes.get(n_landmarks)
    if vertices is None:
        if n_landmarks > model.n_vertices:
            raise InputError(
                f"{model.name} must have {n_landmarks} vertices. Received {model.n_vertices}."
            )
        vertices = rng.choice(model.n_vertices, n_landmarks, replace=False)
    preset = workload.run.preset
    n = min(preset.bench_faces, max(preset.bench_released_faces, _LANDMARKS_OF_ALL // n_landmarks))
    shapes = model.restrict(vertices).sample(n, rng)[1]
    return normalise(shapes)[..., :2]


def _of_landmarks(workload, views):
    n, n_landmarks, _ = views.shape
    variant, net = workload.networks.variant, workload.networks.dissimilarity_net_
    networks, untrained = workload.networks, ""
    if n_landmarks != workload.n_landmarks:
        networks = copy.copy(networks).set_params(n_landmarks=n_landmarks)
        networks.autoencoder_ = build_autoencoder(n_landmarks)
        untrained = _UNTRAINED
    matrices = dissimilarities(net, views, variant)
    # Loops over pairs and four random starts take as long for one face of many landmarks as for
    # many of few.
    few = max(1, workload.run.preset.bench_released_faces * 51**2 // n_landmarks**2)
    some = max(1, n // 5)
    pairs = released.all_pairs(n_landmarks)
    for part, own in (
        (FEATURES, [
            (RELEASED, lambda: [released.pair_features(v, variant, pairs) for v in views[:few]],
             few),
            (OURS, lambda: [pair_features(v, variant) for v in views], n)]),
        (PREDICTION, [
            (RELEASED, lambda: released.predict(networks, views[:few], loops=False), few),
            (OURS, lambda: predict_all(networks, views), n)]),
        (EMBEDDING, [
            (RELEASED, lambda: released.embed(matrices[:few]), few),
            (SKLEARN, lambda: embed_all(matrices, some, "sklearn"), some),
            (BATCHED, parts.compiled(lambda: embed_all(matrices, n, "batched")), n)]),
    ):  # fmt: skip
        ways = [parts.timed(part, name, call, n_landmarks, faces) for name, call, faces in own]
        if part == PREDICTION:
            ways = [replace(way, note=way.note + untrained) for way in ways]
        yield ways
