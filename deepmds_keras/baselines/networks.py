"""Networks of the compared methods, and what their estimators share: restoring and counting."""

from __future__ import annotations

from pathlib import Path
from typing import Self

import keras
import numpy as np
from keras import layers, ops
from sklearn.base import BaseEstimator

from deepmds_keras.checks import check_fitted, check_n_landmarks
from deepmds_keras.errors import InputError
from deepmds_keras.networks import count_trainable, draw_kernels
from deepmds_keras.photos import IMAGE_SIZE
from deepmds_keras.training import restore_network, train_by_epoch

N_POSE = 6  # RingNet's parameters before the coefficients: log scale, x, y, axis-angle
MIN_IMAGE_SIZE = 32  # ResNet-50 halves an image five times


class NetworkMethod(BaseEstimator):
    """An estimator of one network, which is trained by epochs with a checkpoint after each.

    A subclass has `_build(seed)`, and `fit` that ends with `_train`.

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

    def _train(self, network, batches, data: dict, inference, checkpoint, progress) -> Self:
        """`train_by_epoch`; `data` is what the label of the checkpoint says of them."""
        label = {"network": network.name, **data, **self._label()}
        self.history_ = train_by_epoch(network, batches, label, inference, checkpoint, progress)
        self.network_ = network
        return self

    def _label(self) -> dict:
        """Label of the checkpoint: all that the network depends on besides arrays."""
        return {name: value for name, value in self.get_params().items() if not np.ndim(value)}


def check_shape(array: np.ndarray, name: str, shape: tuple[int, ...]) -> None:
    """Raise InputError for an array of another shape."""
    if np.shape(array) != shape:
        raise InputError(f"{name} must have shape {shape}. Received {np.shape(array)}.")


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
    view = x = keras.Input((2 * n_landmarks,), name="view")
    names = [*(f"hidden_{number}" for number in range(1, 6)), "depth"]
    for number, name in enumerate(names):
        units = n_landmarks if name == "depth" else 2 * n_landmarks
        initial = keras.initializers.GlorotUniform(seed=1000 * seed + number)
        x = layers.Dense(units, "tanh", kernel_initializer=initial, name=name)(x)
    return keras.Model(view, x, name=f"zhao_{n_landmarks}")


def build_mobileface_net(n_coefficients: int = 199, *, seed: int = 0) -> keras.Model:
    """MobileNet of width 0.3125 without its head, and one dense layer on all of its last map.

    Args:
        n_coefficients: Components of the face model. 199, as the Basel model has, gives 900,979
            trainable parameters of 907,819.
        seed: Of the initial weights.

    Returns:
        Model from `(n, 96, 96, 3)` images in [-1, 1] to `(n, n_coefficients)`.
    """
    size = (IMAGE_SIZE, IMAGE_SIZE, 3)
    body = keras.applications.MobileNet(size, alpha=0.3125, include_top=False, weights=None)
    features = layers.Flatten(name="features")(body.output)
    raw = layers.Dense(n_coefficients, name="coefficients")(features)
    net = keras.Model(body.input, raw, name=f"mobileface_{n_coefficients}")
    draw_kernels(net, seed)
    return net


def build_ringnet(
    n_identity: int, n_expression: int, image_size: int = 96, seed: int = 0
) -> keras.Model:
    """ResNet-50 on an image, and the camera, pose and coefficients of the face by iteration.

    After Sanyal et al. 2019, arXiv:1905.06817. The 2,048 features of ResNet-50 and the parameters
    as estimated so far go through two layers of 512 ReLU units with dropout and a linear one. Its
    output is added to the estimate. The layers are the same in all iterations, of which there are
    three, as in Kanazawa et al. 2018 (HMR, arXiv:1712.06584), whose regressor it is.

    Two things are ours. The moving averages of the batch normalisation forget ten times as fast as
    Keras's by default. In a training of a few thousand steps they would lag behind the weights. And
    dropout removes a fifth of the units; the sources at hand do not say how many theirs does.

    Args:
        n_identity: Identity coefficients.
        n_expression: Expression coefficients.
        image_size: Width and height of the images, at least 32 pixels.
        seed: Of the initial weights.

    Returns:
        Model from `(n, image_size, image_size, 3)` images in [-1, 1] to the parameters,
        `(n, 6 + n_identity + n_expression)`: log scale, x, y, axis-angle, identity, expression. All
        of them zero are the mean face, seen from the front in the middle of the image.

    Raises:
        InputError: Images of less than 32 pixels.
    """
    if image_size < MIN_IMAGE_SIZE:
        raise InputError(f"image_size must be at least {MIN_IMAGE_SIZE}. Received {image_size}.")
    body = keras.applications.ResNet50(
        input_shape=(image_size, image_size, 3), include_top=False, weights=None, pooling="avg"
    )
    for layer in body.layers:
        if isinstance(layer, layers.BatchNormalization):
            layer.momentum = 0.9
    n_parameters = N_POSE + n_identity + n_expression
    hidden = []
    for number in (1, 2):
        hidden.append(layers.Dense(512, activation="relu", name=f"regressor_{number}"))
        hidden.append(layers.Dropout(0.2, seed=number, name=f"dropout_{number}"))
    step = layers.Dense(n_parameters, name="correction")
    join = layers.Concatenate(name="features_and_estimate")
    features = body.output
    estimate = ops.zeros_like(features[:, :1]) * ops.zeros((1, n_parameters))
    for _ in range(3):
        x = join([features, estimate])
        for layer in hidden:
            x = layer(x)
        estimate = estimate + step(x)
    net = keras.Model(body.input, estimate, name=f"ringnet_{n_identity}_{n_expression}")
    draw_kernels(net, seed)
    # So that training starts about the mean face, seen from the front.
    step.kernel.assign(0.01 * step.kernel)
    return net
