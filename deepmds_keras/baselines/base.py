"""What compared methods with one network share: training, restoring, initial weights."""

from collections.abc import Mapping
from pathlib import Path
from typing import Self

import keras
import numpy as np
from keras import layers
from sklearn.base import BaseEstimator

from deepmds_keras.errors import InputError, check_fork
from deepmds_keras.networks import count_trainable, forward, glorot
from deepmds_keras.training import face_order, restore_network, steps_per_call, train_by_epoch
from deepmds_keras.validation import check_fitted, check_number, check_still_of, check_whole
from deepmds_keras.weights import fingerprint, read_keras2_weights


class NetworkMethod(BaseEstimator):
    """An estimator with one network, trained by epochs with a checkpoint after each.

    A subclass defines `_build(seed)`, and a `fit` that begins with `_compiled` and ends with
    `_train` or `_train_on_arrays`, which take `checkpoint` and `progress` like `train_by_epoch`.
    Common parameters are `learning_rate`, the initial one; `epochs` of `steps_per_epoch`
    mini-batches, each of `batch_size` faces; and `seed`, of the initial weights and of the order of
    the faces.

    Attributes:
        network_: Trained `keras.Model`.
        history_: Losses by epoch: `train` while the weights change, `inference` thereafter.
    """

    def restore(self, checkpoint: str | Path) -> Self:
        """Load the network of a finished `fit`, and train nothing.

        Raises:
            InputError: The file is missing, unfinished, damaged or of another run.
        """
        network = self._build()
        self.history_ = restore_network(network, checkpoint, self._label())["history"]
        self.network_ = network
        return self

    def load_released(self, path: str | Path) -> Self:
        """Load the authors' weights, a Keras 2 file; errors as in `read_keras2_weights`."""
        network = self._build()
        read_keras2_weights(network, path)
        self.network_ = network
        return self

    @property
    def n_parameters(self) -> int:
        """Trainable parameters."""
        return count_trainable(self._trained())

    def _trained(self) -> keras.Model:
        network = check_fitted(self, "network_", "fit or restore")
        if hasattr(self, "n_landmarks"):
            check_still_of(network.input_shape[1] // 2, self.n_landmarks)
        return network

    def _check_parameters(self) -> None:
        for name, value in self.get_params().items():
            if name in ("epochs", "steps_per_epoch", "batch_size", "units"):
                check_whole(value, name)
        check_whole(self.seed, "seed", 0)
        check_number(self.learning_rate, "learning_rate")

    def _compiled(self, optimizer, loss, **options) -> keras.Model:
        network, calls = self._build(self.seed), steps_per_call(self.steps_per_epoch)
        network.compile(optimizer, loss, steps_per_execution=calls, **options)
        return network

    def _train(self, network, mini_batches, data: tuple, inference, **training) -> Self:
        """`train_by_epoch`; the arrays of `data` identify the run, with the parameters."""
        label = {**self._label(), "data": fingerprint(*data, *self._arrays().values())}
        self.history_ = train_by_epoch(network, mini_batches, label, inference, **training)
        # Not compiled, like one that is restored: a loss of ours cannot be pickled.
        self.network_ = keras.Model(network.input, network.output, name=network.name)
        return self

    def _train_on_arrays(self, network, inputs, targets, **training) -> Self:
        """`_train` on `(n, …)` float32 arrays over all faces, with mean squared errors."""
        n, steps, batch = len(inputs), self.steps_per_epoch, self.batch_size

        def mini_batches(epoch: int) -> dict:
            faces = face_order(n, steps * batch, self.seed, epoch)
            return {"x": inputs[faces], "y": targets[faces], "batch_size": batch}

        def inference() -> float:
            return float(np.mean((forward(network, inputs) - targets) ** 2))

        return self._train(network, mini_batches, (inputs, targets), inference, **training)

    def _label(self) -> dict:
        """Everything that the network depends on besides its data."""
        arrays, parameters = self._arrays(), self.get_params().items()
        numbers = {name: value for name, value in parameters if name not in arrays}
        return {**numbers, "arrays": {name: fingerprint(a) for name, a in arrays.items()}}

    def _arrays(self) -> dict[str, np.ndarray]:
        """The parameters that are arrays, such as those of a face model."""
        return {name: value for name, value in self.get_params().items() if np.ndim(value)}


def dense_network(
    name: str,
    n_inputs: int,
    sizes: Mapping[str, tuple[int, str | None]],
    seed: int,
    standardised: bool = False,
) -> keras.Model:
    """A stack of dense layers on the `(n, n_inputs)` numbers of a view.

    Args:
        sizes: Units and activation of each layer, by its name.
        seed: Seed of the initial weights.
        standardised: Whether the numbers are first centred and divided by their s.d., in a layer
            `"standardised"` with their mean and variance as untrained weights.
    """
    check_fork("Keras")
    view = x = keras.Input((n_inputs,), name="view")
    if standardised:
        x = layers.BatchNormalization(
            center=False, scale=False, epsilon=1e-8, trainable=False, name="standardised"
        )(view)
    for number, (layer, (units, activation)) in enumerate(sizes.items()):
        initial = glorot(1000 * seed + number)
        x = layers.Dense(int(units), activation, kernel_initializer=initial, name=layer)(x)
    return keras.Model(view, x, name=name)


def check_shape(array: np.ndarray, name: str, shape: tuple[int, ...]) -> None:
    """Raise InputError for an array of another shape."""
    if np.shape(array) != shape:
        raise InputError(f"{name} must have shape {shape}. Received {np.shape(array)}.")


def draw_kernels(network: keras.Model, seed: int) -> None:
    """Redraw every kernel by Keras's default, for networks that take no initialiser."""
    kernels = [weight for weight in network.trainable_weights if weight.name.endswith("kernel")]
    for number, kernel in enumerate(kernels):
        kernel.assign(glorot(1000 * seed + number)(kernel.shape))
