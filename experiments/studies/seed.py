"""Stage: every form of Deep-MDS, and the mean shape, from one seed, on faces of that seed.

It is a run of `make reproduce-bfm SEED=…` cut down to these methods, whose files that command goes
on from.
"""

from __future__ import annotations

import numpy as np

from experiments.arguments import parse_run
from experiments.inputs import Faces, load_faces
from experiments.methods import DEEP_MDS, METHODS, load
from experiments.metrics import METRICS
from experiments.run import Run
from experiments.running import stage
from experiments.scoring.scores import load_prediction, score
from experiments.tracks.networks import chains, train_chain
from experiments.trainings import side_by_side

_SCORES = ("mse", "mse_mm2", "depth_corr", "reflection_rate")


def run_seed(run: Run) -> list[tuple[str, str, float]]:
    """Train and score; what the seed's folder already holds is used.

    Returns:
        Rows of `method, metric, value`.
    """
    from experiments.tracks.predictions import predict

    own = [[method for method in chain if method in DEEP_MDS] for chain in chains(run)]
    side_by_side(run.jobs, train_chain, [(run, chain) for chain in own if chain])
    train, test = load_faces(run, "train"), load_faces(run, "test")
    rows = []
    for method in ("mean_shape", *DEEP_MDS):
        predict(run, test, METHODS[method])
        scores = score(load_prediction(run, method)[0]["shapes"], test)
        values = {metric: METRICS[metric].per_face(scores).mean() for metric in _SCORES}
        if method in DEEP_MDS:
            values |= _autoencoder_errors(run, train, method)
        rows += [(method, metric, float(value)) for metric, value in values.items()]
    return rows


def _autoencoder_errors(run: Run, train: Faces, method: str) -> dict[str, float]:
    """Mean squared errors of the autoencoder on the training faces, by statistics."""
    from deepmds_keras.networks import forward
    from experiments.studies.batchnorm import recalibrate_batchnorm

    model = load(run, method)
    network, history = model.autoencoder_, model.history_["autoencoder"]
    flat = train.views.reshape(len(train.views), -1)
    anew = forward(recalibrate_batchnorm(network, flat), flat).reshape(train.views.shape)
    return {
        "autoencoder_mse_train": history["train"][-1],
        "autoencoder_mse_inference": history["inference"][-1],
        "autoencoder_mse_reestimated": np.mean((anew - train.shapes[..., :2]) ** 2),
    }


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    with stage(run, "seed") as record:
        record["rows"] = run_seed(run)
