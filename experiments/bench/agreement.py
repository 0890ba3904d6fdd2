"""Both solvers of the embedding on the test faces of every run that is trained here."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from data_gen.models.registry import MODELS
from deepmds_keras.alignment import align
from deepmds_keras.embedding import SOLVERS, embed
from experiments.bench.workload import WEIGHTS, Workload
from experiments.inputs import load_faces
from experiments.methods import DEEP_MDS, load
from experiments.run import SCHEMES, Run

COLUMNS = (
    "model", "experiment", "method", "n_faces", "largest_stress_difference",
    "largest_shape_difference", "times_sklearn",
)  # fmt: skip

_FACES_IN_TURN = 100  # by either solver, so that what else the machine does meets both


def cases(workload: Workload) -> Iterator[tuple[str, str, str, np.ndarray]]:
    """Model, experiment, method and dissimilarities `(n, L, L)` of its test faces."""
    n = workload.run.preset.bench_compared_faces
    yield workload.model.name, "shipped weights", WEIGHTS, workload.matrices[:n]
    for run in trained_runs(workload.run):
        test = load_faces(run, "test")
        for method in DEEP_MDS:
            matrices = load(run, method).dissimilarities(test.views[:n])
            yield run.model, run.track, method, np.abs(matrices)


def trained_runs(run: Run) -> list[Run]:
    """Runs of this preset, protocol and seed whose networks and test faces are complete."""
    runs = [replace(run, model=model, track=track) for model in MODELS for track in SCHEMES]
    return [
        own
        for own in runs
        if (own.trained.work / "networks.json").exists() and (own.work / "test.npz").exists()
    ]


def compare(matrices: np.ndarray) -> dict[str, float]:
    """Agreement of the batched solver with scikit-learn's on the same faces, and its speed.

    Args:
        matrices: `(n, L, L)` dissimilarities.

    Returns:
        The largest difference of stress-1 and of the shape after Procrustes alignment, both
        relative, and how many times as many faces per second.
    """
    shapes, stress, seconds = ({solver: [] for solver in SOLVERS} for _ in range(3))
    for start in range(0, len(matrices), _FACES_IN_TURN):
        for solver in SOLVERS:
            faces = matrices[start : start + _FACES_IN_TURN]
            clock = time.perf_counter()
            some = embed(faces, solver=solver, return_stress=True)
            seconds[solver].append(time.perf_counter() - clock)
            shapes[solver].append(some[0])
            stress[solver].append(some[1])
    shapes, stress = (
        {solver: np.concatenate(own) for solver, own in both.items()} for both in (shapes, stress)
    )
    truth = shapes["sklearn"]
    apart = np.linalg.norm(align(shapes["batched"], truth) - truth, axis=(1, 2))
    return {
        "n_faces": len(matrices),
        "largest_stress_difference": float(np.abs(stress["batched"] / stress["sklearn"] - 1).max()),
        "largest_shape_difference": float((apart / np.linalg.norm(truth, axis=(1, 2))).max()),
        "times_sklearn": sum(seconds["sklearn"]) / sum(seconds["batched"]),
    }
