"""Landmark depth by a dense network, after Zhao et al. 2017 as the paper's authors trained it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import keras
import numpy as np
import tensorflow as tf
from sklearn.base import BaseEstimator

from deepmds_keras.checks import check_faces, check_fitted, check_n_landmarks
from deepmds_keras.errors import InputError
from deepmds_keras.networks import forward
from deepmds_keras.training import face_order, restore_network, steps_per_call, train_by_epoch

OPTIMIZERS = ("adam", "rmsprop")


def build_zhao_net(n_landmarks: int = 72, *, seed: int = 0) -> keras.Model:
    """Five hidden dense layers as wide as the input and a dense output, all with tanh.

    Args:
        n_landmarks: L. 72 gives 114,840 parameters (the paper's number), 51 gives 57,783.
        seed: Of the initial weights.

    Returns:
        Model from `(n, 2L)` coordinates x1, y1, x2, … to `(n, L)` depths.

    Raises:
        InputError: No whole number of landmarks, or fewer than 3.
    """
    check_n_landmarks(n_landmarks)
    seeds = iter(range(1000 * seed, 1000 * seed + 1000))

    def dense_tanh(x, units, name):
        initial = keras.initializers.GlorotUniform(seed=next(seeds))
        return keras.layers.Dense(units, "tanh", kernel_initializer=initial, name=name)(x)

    view = x = keras.Input((2 * n_landmarks,), name="view")
    for number in range(1, 6):
        x = dense_tanh(x, 2 * n_landmarks, f"hidden_{number}")
    depth = dense_tanh(x, n_landmarks, "depth")
    return keras.Model(view, depth, name=f"zhao_{n_landmarks}")


class Zhao(BaseEstimator):
    """Depth of each landmark in the camera's frame; x and y are the view itself.

    Zhao et al. 2017, arXiv:1609.09058, in the topology and recipe of the paper's authors: MSE, and
    each face in a unit of its own, see `normalise_view`. In that unit a frontal depth just fits
    into the range of tanh; that of a face turned by 45 degrees does not. The paper says that Adam
    trained all networks; the authors' code took RMSprop for this one.

    Shapes come out with x, y and depth in that same unit. The authors' evaluator instead rescales
    the predicted depth to [0, 1] by itself and joins it to the true x and y, whose depth spans
    about 0.4: scored so even a perfect depth has an MSE of 2.1e-3, which is the number that the
    paper reports for this method.

    Args:
        n_landmarks: L.
        optimizer: `"adam"` or `"rmsprop"`.
        learning_rate: Of the optimiser.
        epochs: Rounds of `steps_per_epoch` mini-batches.
        steps_per_epoch: Mini-batches in an epoch.
        batch_size: Faces in a mini-batch.
        seed: Of the initial weights and the order of the faces.

    Attributes:
        network_: Trained `keras.Model`.
        history_: Losses by epoch: `train` while the weights change, `inference` thereafter.
    """

    def __init__(
        self,
        n_landmarks: int = 72,
        *,
        optimizer: str = "adam",
        learning_rate: float = 1e-3,
        epochs: int = 10,
        steps_per_epoch: int = 1000,
        batch_size: int = 16,
        seed: int = 0,
    ):
        self.n_landmarks = n_landmarks
        self.optimizer = optimizer
        self.learning_rate = learning_rate
        self.epochs = epochs
        self.steps_per_epoch = steps_per_epoch
        self.batch_size = batch_size
        self.seed = seed

    def fit(
        self,
        points: np.ndarray,
        *,
        checkpoint: str | Path | None = None,
        progress: Callable[[dict], object] | None = None,
    ) -> Zhao:
        """Train on faces in the camera's frame.

        The depth has to be in the frame and unit of x and y, so that both come as one array.

        Args:
            points: `(n, L, 3)`: x and y as in the view, and depth towards the viewer.
            checkpoint: File to go on from, and to write after every epoch.
            progress: Called after every epoch with its losses.

        Raises:
            InputError: NaN, infinity, degenerate or another number of landmarks, another optimiser,
                or a checkpoint of another run.
        """
        if self.optimizer not in OPTIMIZERS:
            raise InputError(
                f"optimizer must be one of {', '.join(OPTIMIZERS)}. Received {self.optimizer!r}."
            )
        points = check_faces(points, "points", 3, self.n_landmarks)
        centred = points - points.mean(1, keepdims=True)
        views, size = normalise_view(points[..., :2])
        views = np.float32(views).reshape(len(points), -1)
        depths = np.float32(centred[..., 2] / size[..., 0])
        steps, batch = self.steps_per_epoch, self.batch_size
        network = build_zhao_net(self.n_landmarks, seed=self.seed)
        optimizer = keras.optimizers.get(
            {"class_name": self.optimizer, "config": {"learning_rate": self.learning_rate}}
        )
        network.compile(optimizer, "mse", steps_per_execution=steps_per_call(steps))

        def batches(epoch: int) -> tf.data.Dataset:
            faces = face_order(len(points), steps * batch, self.seed, epoch).reshape(steps, batch)
            return tf.data.Dataset.from_tensor_slices((views[faces], depths[faces]))

        def inference() -> float:
            predicted = forward(network, views)
            return float(np.mean((predicted - depths) ** 2))

        label = {"network": network.name, "faces": len(points), **self.get_params()}
        self.history_ = train_by_epoch(network, batches, label, inference, checkpoint, progress)
        self.network_ = network
        return self

    def restore(self, checkpoint: str | Path) -> Zhao:
        """Take the network that `fit` trained to the end, and train nothing.

        Raises:
            InputError: The file is missing, unfinished, damaged or of another run.
        """
        self.network_ = build_zhao_net(self.n_landmarks)
        self.history_ = restore_network(self.network_, checkpoint, self.get_params())
        return self

    def predict(self, views: np.ndarray) -> np.ndarray:
        """Shapes in the camera's frame.

        Args:
            views: `(n, L, 2)`, any scale and place.

        Returns:
            `(n, L, 3)` normalised x and y, and depth towards the viewer in the same unit.

        Raises:
            InputError: Not trained, or NaN, infinity, degenerate or another number of landmarks.
        """
        network = check_fitted(self, "network_", "fit or restore")
        views, _ = normalise_view(check_faces(views, "views", 2, self.n_landmarks))
        flat = np.float32(views).reshape(len(views), -1)
        depths = forward(network, flat)
        return np.concatenate([views, depths[..., None]], axis=2)

    @property
    def n_parameters(self) -> int:
        """Trainable parameters; all of them are."""
        return check_fitted(self, "network_", "fit or restore").count_params()


def normalise_view(views: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each view centred and divided by std(x) + std(y), as the released code does.

    Args:
        views: `(n, L, 2)`.

    Returns:
        Normalised views and what they were divided by, `(n, 1, 1)`.
    """
    size = views.std(1).sum(1)[:, None, None]
    return (views - views.mean(1, keepdims=True)) / size, size
