"""What the compared methods of one network share: training, restoring, initial weights."""

from __future__ import annotations

from pathlib import Path
from typing import Self

import keras
import numpy as np
from sklearn.base import BaseEstimator

from deepmds_keras.checks import check_fitted
from deepmds_keras.errors import InputError
from deepmds_keras.networks import count_trainable
from deepmds_keras.training import restore_network, steps_per_call, train_by_epoch


class NetworkMethod(BaseEstimator):
    """An estimator of one network, which is trained by epochs with a checkpoint after each.

    A subclass has `_build(seed)`, and `fit` that begins with `_compiled` and ends with `_train`,
    which takes `checkpoint` and `progress`, as `train_by_epoch`.

    Attributes:
        network_: Trained `keras.Model`.
        history_: Losses by epoch: `train` while the weights change, `inference` thereafter.
    """

    def restore(self, checkpoint: str | Path) -> Self:
        """Load the network that `fit` trained to the end, and train nothing.

        Raises:
            InputError: The file is missing, unfinished, damaged or of another run.
        """
        network = self._build()
        self.history_ = restore_network(network, checkpoint, self._label())
        self.network_ = network
        return self

    @property
    def n_parameters(self) -> int:
        """Trainable parameters."""
        return count_trainable(self._trained())

    def _trained(self) -> keras.Model:
        return check_fitted(self, "network_", "fit or restore")

    def _compiled(self, optimizer, loss, **options) -> keras.Model:
        network, calls = self._build(self.seed), steps_per_call(self.steps_per_epoch)
        network.compile(optimizer, loss, steps_per_execution=calls, **options)
        return network

    def _train(self, network, batches, data: dict, inference, **training) -> Self:
        """`train_by_epoch`; `data` is what the label of the checkpoint says of them."""
        label = {"network": network.name, **data, **self._label()}
        self.history_ = train_by_epoch(network, batches, label, inference, **training)
        self.network_ = network
        return self

    def _label(self) -> dict:
        """All that the network depends on besides arrays."""
        return {name: value for name, value in self.get_params().items() if not np.ndim(value)}


def check_shape(array: np.ndarray, name: str, shape: tuple[int, ...]) -> None:
    """Raise InputError for an array of another shape."""
    if np.shape(array) != shape:
        raise InputError(f"{name} must have shape {shape}. Received {np.shape(array)}.")


def draw_kernels(network: keras.Model, seed: int) -> None:
    """Draw every kernel again, in Keras's default way: for networks that take no initialiser."""
    kernels = [weight for weight in network.trainable_weights if weight.name.endswith("kernel")]
    for number, kernel in enumerate(kernels):
        initial = keras.initializers.GlorotUniform(seed=1000 * seed + number)
        kernel.assign(initial(kernel.shape))
