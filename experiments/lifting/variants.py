"""The dissimilarity nets of `component_ablation`, each of which differs from another in one thing.

The module is light to import, since the Snakefile reads it.
"""

from dataclasses import dataclass, replace
from pathlib import Path

from experiments.lifting.train import LIFTING
from experiments.run import Run

SIDE_AUTOENCODER = "side_autoencoder"


@dataclass(frozen=True)
class Variant:
    """A net and its training; the defaults are the paper's, but for the cosine schedule.

    Attributes:
        schedule: Learning rate of the net and of the autoencoder before it.
        units: Units of each hidden layer.
        shuffled: Whether a mini-batch has the same number of pairs drawn from all faces. With pairs
            of one face, batch normalisation removes what the whole face has in common.
        identity: Whether the net knows which two landmarks it sees.
        whole_view: Whether it also sees the whole input view.
        frontal: Views whose pairs are used: from the `"autoencoder"`, the `"true"` frontal ones, or
            from the side (`"side"`), by an autoencoder trained to predict those.
        rescaled: Whether views of the autoencoder are normalised again.
    """

    schedule: str = "cosine"
    units: int = 20
    shuffled: bool = False
    identity: bool = False
    whole_view: bool = False
    frontal: str = "autoencoder"
    rescaled: bool = True


_WIDE = Variant(units=64)
_SHUFFLED = replace(_WIDE, shuffled=True)
_KNOWN = replace(_SHUFFLED, identity=True)
VARIANTS = {
    "constant": Variant(schedule="constant"),
    "cosine": Variant(),
    "true_frontal": Variant(frontal="true"),
    "side": Variant(frontal="side"),
    "not_rescaled": Variant(rescaled=False),
    "wide": _WIDE,
    "shuffled": _SHUFFLED,
    "landmarks_known": _KNOWN,
    "whole_view": replace(_KNOWN, whole_view=True),
}

# Rows of its table.
STEPS = {
    "mean_shape": "Mean shape",
    "constant": "Deep-MDS, constant rate",
    "recalibrated": "… statistics of batch normalisation recomputed",
    "cosine": "Deep-MDS, cosine schedule (A)",
    "side": "A on views from the side",
    "not_rescaled": "A without the second min-max",
    "true_frontal_tested": "A tested on true frontal views",
    "true_frontal": "A trained and tested on true frontal views",
    "wide": "A with 64 units instead of 20 (B)",
    "shuffled": "B with shuffled mini-batches (C)",
    "landmarks_known": "C + landmark identity (D)",
    "whole_view": "D + full 2D input",
    "landmark_lifter": "The distances of LandmarkLifter",
    "true_distances": "The true distances",
    "lower_bound": "Approximate lower bound: with the face model and the camera known",
}


def component_trainings(run: Run) -> list[str]:
    """Names of what is trained: a method and a seed, the slow ones first."""
    names = [f"{method}-seed{seed}" for method in (LIFTING, *VARIANTS) for seed in run.few_seeds]
    return [f"{SIDE_AUTOENCODER}-seed{run.seed}", *names]


def component_file(run: Run, method: str, seed: int) -> Path:
    """Trained network."""
    suffix = "npz" if method == LIFTING else "keras"
    return run.work / "component-ablation" / f"{method}-seed{seed}.{suffix}"
