"""Coefficients of a face model from an image, as the paper's authors built MobileFace."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import keras
import numpy as np
import tensorflow as tf
from keras import ops
from sklearn.base import BaseEstimator

from deepmds_keras.checks import check_fitted, check_images
from deepmds_keras.errors import InputError
from deepmds_keras.keras2_weights import read_keras2_weights
from deepmds_keras.networks import count_trainable, draw_kernels, forward_images
from deepmds_keras.photos import IMAGE_SIZE
from deepmds_keras.training import (
    Recipe,
    face_order,
    image_batches,
    restore_network,
    steps_per_call,
    train_by_epoch,
)

STANDARDISED = ("face", "batch")
_WIDTH = 0.3125  # MobileNet's alpha
_IMAGES_PER_CALL = 250
_CHECK_FACES = 500


def build_mobileface_net(n_coefficients: int = 199, *, seed: int = 0) -> keras.Model:
    """MobileNet of width 0.3125 without its head, and one dense layer on all of its last map.

    Args:
        n_coefficients: Components of the face model. 199, as the Basel model has, gives 900,979
            trainable parameters of 907,819.
        seed: Of the initial weights.

    Returns:
        Model from `(n, 96, 96, 3)` images in [-1, 1] to `(n, n_coefficients)`.
    """
    body = keras.applications.MobileNet(
        (IMAGE_SIZE, IMAGE_SIZE, 3), alpha=_WIDTH, include_top=False, weights=None
    )
    features = keras.layers.Flatten(name="features")(body.output)
    raw = keras.layers.Dense(n_coefficients, name="coefficients")(features)
    net = keras.Model(body.input, raw, name=f"mobileface_{n_coefficients}")
    draw_kernels(net, seed)
    return net


class MobileFace(BaseEstimator):
    """MobileNet that regresses the identity coefficients of a face model, whatever the pose.

    After Chinaev et al. 2018, arXiv:1809.08809, in the topology and recipe of the paper's authors:
    Adam, and for a loss the mean squared error over all coordinates of the face model's mesh. Since
    both shapes are of the model, that is a quadratic form of the difference of coefficients, and no
    mesh need be made to compute it.

    The authors standardise the raw coefficients to mean 0 and s.d. 1 before they shape a face, in
    training over all numbers of a mini-batch and, one image at a time, over one face in use.
    `standardise="batch"` does so too; `"face"` takes the numbers of one face in both.

    Args:
        landmark_mean: `(L, 3)` landmarks of the mean face, millimetres.
        landmark_basis_times_sd: `(K, L, 3)` what one s.d. of each component adds to them.
        shape_gram: `(K, K)` mean over all coordinates of the mesh of the product of two components'
            offsets at one s.d., square millimetres.
        standardise: One of `STANDARDISED`: over what, in training.
        schedule: `"constant"` learning rate, as the authors have it, or `"cosine"` decay to zero.
        learning_rate: Of Adam, at the start.
        epochs: Rounds of `steps_per_epoch` mini-batches.
        steps_per_epoch: Mini-batches in an epoch.
        batch_size: Faces in a mini-batch.
        seed: Of the initial weights and the order of the faces.

    Attributes:
        network_: Trained `keras.Model`.
        history_: Losses by epoch in square millimetres: `train` while the weights change,
            `inference` thereafter, over a fixed five hundred of the faces.
    """

    def __init__(
        self,
        landmark_mean: np.ndarray,
        landmark_basis_times_sd: np.ndarray,
        shape_gram: np.ndarray | None = None,
        *,
        standardise: str = "face",
        schedule: str = "constant",
        learning_rate: float = 1e-3,
        epochs: int = 200,
        steps_per_epoch: int = 500,
        batch_size: int = 16,
        seed: int = 0,
    ):
        self.landmark_mean = landmark_mean
        self.landmark_basis_times_sd = landmark_basis_times_sd
        self.shape_gram = shape_gram
        self.standardise = standardise
        self.schedule = schedule
        self.learning_rate = learning_rate
        self.epochs = epochs
        self.steps_per_epoch = steps_per_epoch
        self.batch_size = batch_size
        self.seed = seed

    def fit(
        self,
        images,
        coefficients: np.ndarray,
        *,
        checkpoint: str | Path | None = None,
        progress: Callable[[dict], object] | None = None,
    ) -> MobileFace:
        """Train on images of faces whose coefficients are known.

        Args:
            images: `(n, 96, 96, 3)` uint8, an array or what is indexed like one; a mini-batch at a
                time is read.
            coefficients: `(n, K)` standard-normal identity coefficients.
            checkpoint: File to go on from, and to write after every epoch.
            progress: Called after every epoch with its losses.

        Raises:
            InputError: Unequal numbers, no `shape_gram`, or a checkpoint of another run.
        """
        n, n_coefficients = len(images), len(self.landmark_basis_times_sd)
        if coefficients.shape != (n, n_coefficients):
            raise InputError(
                f"coefficients must have shape ({n}, {n_coefficients}), a row for each image. "
                f"Received {coefficients.shape}."
            )
        if np.shape(self.shape_gram) != (n_coefficients, n_coefficients):
            raise InputError(
                f"shape_gram must have shape ({n_coefficients}, {n_coefficients}) to train. "
                f"Received {np.shape(self.shape_gram)}."
            )
        coefficients = np.float32(coefficients)
        loss = self._loss()
        network = build_mobileface_net(n_coefficients, seed=self.seed)
        steps, batch = self.steps_per_epoch, self.batch_size
        recipe = Recipe(self.epochs, steps, self.schedule, self.learning_rate, batch)
        network.compile(recipe.optimizer(steps), loss, steps_per_execution=steps_per_call(steps))

        def batches(epoch: int) -> tf.data.Dataset:
            order = face_order(n, steps * batch, self.seed, epoch).reshape(steps, batch)
            return image_batches(images, coefficients, order)

        check = np.arange(min(n, _CHECK_FACES))

        def inference() -> float:
            raw = forward_images(network, images[check], _IMAGES_PER_CALL)
            return float(np.mean(loss(coefficients[check], raw)))

        label = {"network": network.name, "faces": n, **self._label()}
        self.history_ = train_by_epoch(network, batches, label, inference, checkpoint, progress)
        self.network_ = network
        return self

    def restore(self, checkpoint: str | Path) -> MobileFace:
        """Take the network that `fit` trained to the end, and train nothing.

        Raises:
            InputError: The file is missing, unfinished, damaged or of another run.
        """
        self.network_ = build_mobileface_net(len(self.landmark_basis_times_sd))
        self.history_ = restore_network(self.network_, checkpoint, self._label())
        return self

    def load_released(self, path: str | Path) -> MobileFace:
        """Take the authors' trained weights (`deep_mobileface_occ.h5`) for the network's.

        Raises:
            InputError: Missing or truncated file, or of another number of coefficients.
        """
        network = build_mobileface_net(len(self.landmark_basis_times_sd))
        read_keras2_weights(network, path)
        self.network_ = network
        return self

    def coefficients(self, images: np.ndarray) -> np.ndarray:
        """Identity coefficients of the faces in images, of mean 0 and s.d. 1 over each face.

        Args:
            images: `(n, 96, 96, 3)` uint8.

        Returns:
            `(n, K)`.

        Raises:
            InputError: Not trained, or images of another kind or size.
        """
        network = check_fitted(self, "network_", "fit, restore or load_released")
        raw = forward_images(network, check_images(images, IMAGE_SIZE), _IMAGES_PER_CALL)
        return np.asarray(_standardised(raw, "face"))

    def predict(self, images: np.ndarray) -> np.ndarray:
        """Landmarks of the faces in images, in the frame of the face model: the front.

        Args:
            images: `(n, 96, 96, 3)` uint8.

        Returns:
            `(n, L, 3)` millimetres.

        Raises:
            InputError: As `coefficients`.
        """
        offsets = np.tensordot(self.coefficients(images), self.landmark_basis_times_sd, 1)
        return self.landmark_mean + offsets

    @property
    def n_parameters(self) -> int:
        """Trainable parameters."""
        network = check_fitted(self, "network_", "fit, restore or load_released")
        return count_trainable(network)

    def _label(self) -> dict:
        """Label of the checkpoint: all that the network depends on beside the data."""
        arrays = ("landmark_mean", "landmark_basis_times_sd", "shape_gram")
        return {name: own for name, own in self.get_params().items() if name not in arrays}

    def _loss(self) -> Callable:
        """Mean squared error over all coordinates of the mesh, from coefficients."""
        if self.standardise not in STANDARDISED:
            raise InputError(
                f"standardise must be one of {', '.join(STANDARDISED)}. "
                f"Received {self.standardise!r}."
            )
        gram, over = np.float32(self.shape_gram), self.standardise

        def mean_squared_error_of_shapes(true_coefficients, raw):
            difference = _standardised(raw, over) - true_coefficients
            return ops.sum(ops.matmul(difference, gram) * difference, axis=1)

        return mean_squared_error_of_shapes


def _standardised(raw, over: str):
    """Mean 0 and s.d. 1 over each face, or over the whole batch."""
    axis = 1 if over == "face" else None
    mean, sd = ops.mean(raw, axis, keepdims=True), ops.std(raw, axis, keepdims=True)
    return (raw - mean) / sd
