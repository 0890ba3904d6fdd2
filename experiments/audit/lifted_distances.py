"""A reviewer's question: what MDS adds where a network's distances are those of a shape.

The lifting network gives points. Their distances are Euclidean and of three dimensions by
construction, which is all that MDS could make of dissimilarities.
"""

from __future__ import annotations

import numpy as np

from deepmds_keras.alignment import align
from deepmds_keras.embedding import embed, pairwise_distances
from deepmds_keras.metrics import mse
from experiments.audit.evidence import Inputs
from experiments.audit.findings import Finding, does_not_hold, holds
from experiments.methods import title
from experiments.scoring.numbers import scientific

_ROUNDING = 1e-9  # share of an error below which a difference is nothing but rounding


def measure(inputs: Inputs) -> dict:
    """Measure what scikit-learn's non-metric MDS makes of both networks' distances.

    `moved` is the largest root mean square, over the landmarks of a face, of the difference between
    the lifter's shape and the embedding of its distances, after Procrustes alignment; `error` that
    of the lifter's shapes from the truth, of all faces. `stress` is the largest stress-1 of these
    embeddings, `learnt_stress` the mean one of Deep-MDS.
    """
    test = inputs.test[inputs.audited]
    shapes = inputs.method("lifting").predict(test.views).astype(float)
    points, stress = embed(pairwise_distances(shapes), return_stress=True)
    truth = test.shapes.astype(float)
    learnt = np.abs(inputs.method("ours").dissimilarities(test.views))
    return {
        "n_faces": len(shapes),
        "moved": float(np.sqrt(mse(align(points, shapes), shapes).max())),
        "error": float(np.sqrt(mse(align(shapes, truth), truth).mean())),
        "stress": float(stress.max()),
        "learnt_stress": float(embed(learnt, solver="batched", return_stress=True)[1].mean()),
    }


def nothing_added(
    n_faces: int, moved: float, error: float, stress: float, learnt_stress: float
) -> Finding:
    """Does MDS of the distances of the lifter's shapes give back the shapes?"""
    evidence = (
        f"scikit-learn's non-metric MDS of the distances of the shapes that {title('lifting')} "
        f"finds in {n_faces} test faces gives these shapes: they differ by "
        f"{scientific(moved, 2)} r.m.s. in the worst face, where their error is "
        f"{scientific(error, 2)}, with a stress of {scientific(stress, 2)} at most. The "
        f"dissimilarities of {title('ours')} are no distances of any shape: embedded they keep a "
        f"stress of {scientific(learnt_stress, 2)}."
    )
    return (holds if moved <= _ROUNDING * error else does_not_hold)(evidence)
