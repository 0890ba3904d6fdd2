"""Step: errors of Deep-MDS, in its three forms, and of the mean shape, from one seed.

It scores the predictions of these methods in a BFM run of that seed.
"""

import keras
import numpy as np

from deepmds_keras.networks import forward
from experiments.inputs import Faces, load_faces
from experiments.methods import CONSTANT, DEEP_MDS, constant_answers, load
from experiments.run import Run
from experiments.scoring.metrics import METRICS
from experiments.scoring.scores import load_prediction, score

_SCORES = ("mse", "mse_mm2", "depth_corr", "reflection_rate")


def main(run: Run) -> dict:
    """Return rows of `method, metric, value` for the record."""
    train, test = load_faces(run, "train"), load_faces(run, "test")
    rows = []
    shapes = {m: load_prediction(run, m)[0]["shapes"] for m in ("mean_shape", *DEEP_MDS)}
    shapes[CONSTANT] = constant_answers(shapes["deep_mds"])
    for method, predicted in shapes.items():
        scores = score(predicted, test)
        values = {metric: METRICS[metric].per_face(scores).mean() for metric in _SCORES}
        if method in DEEP_MDS:
            values |= autoencoder_errors(run, train, method)
        rows += [(method, metric, float(value)) for metric, value in values.items()]
    return {"rows": rows}


def autoencoder_errors(run: Run, train: Faces, method: str) -> dict[str, float]:
    """Mean squared errors on the training faces, by the statistics of batch normalisation."""
    model = load(run, method)
    history = model.history_["autoencoder"]
    flat = train.views.reshape(len(train.views), -1)
    recalibrated = recalibrate_batchnorm(model.autoencoder_, flat)
    frontal = forward(recalibrated, flat).reshape(train.views.shape)
    return {
        "autoencoder_mse_train": history["train"][-1],
        "autoencoder_mse_inference": history["inference"][-1],
        "autoencoder_mse_reestimated": np.mean((frontal - train.shapes[..., :2]) ** 2),
    }


def recalibrate_batchnorm(network: keras.Model, inputs: np.ndarray) -> keras.Model:
    """The same weights with the batch normalisation of the inputs of its training, as one batch.

    Training leaves in each such layer a running average over past mini-batches and past weights.
    The gain from recalibration is the cost of that lag. Inputs are `(n, d)`; the network itself is
    not changed.
    """
    copy = keras.models.clone_model(network)
    copy.set_weights(network.get_weights())
    for layer in copy.layers:
        if isinstance(layer, keras.layers.BatchNormalization):
            layer.momentum = 0.0  # drop the old average
    copy(inputs, training=True)
    return copy
