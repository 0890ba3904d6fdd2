"""Coefficients of a face model from an image, as the paper's authors built MobileFace."""

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import Self

import keras
import numpy as np
from keras import layers, ops

from deepmds_keras.baselines.base import NetworkMethod, check_shape, draw_kernels
from deepmds_keras.baselines.images import IMAGE_SIZE, check_images, forward_images, image_batches
from deepmds_keras.errors import InputError, check_choice, check_fork
from deepmds_keras.training import Recipe, face_order
from deepmds_keras.validation import as_numbers, check_basis

_IMAGES_PER_CALL = 250
_CHECK_FACES = 500


@dataclass(eq=False, repr=False)
class MobileFace(NetworkMethod):
    """MobileNet that regresses the identity coefficients of a face model, whatever the pose.

    After Chinaev et al. 2018, arXiv:1809.08809, in the topology and recipe of the paper's authors:
    Adam, and as loss the mean squared error over all coordinates of the face model's mesh. Since
    both shapes belong to the model, that is a quadratic form in the difference of coefficients, and
    needs no mesh.

    The authors standardise the raw coefficients to mean 0 and s.d. 1 before use: in training over
    all numbers of a mini-batch, and in prediction, one image at a time, over those of one face.
    `standardise="batch"` does the same; `"face"` uses the numbers of one face in both.

    Args:
        landmark_mean: `(L, 3)` landmarks of the mean face, millimetres.
        landmark_basis_times_sd: `(K, L, 3)` their offsets at one s.d. of each component, K >= 2.
        shape_gram: `(K, K)` mean over all coordinates of the mesh of the product of two components'
            offsets at one s.d., square millimetres.
        standardise: `"face"` or `"batch"`: what training standardises over.
        schedule: `"constant"` learning rate, like the authors', or `"cosine"` decay to zero.

    Attributes:
        history_: Losses in mm²; `inference` is over a fixed choice of five hundred faces.
    """

    landmark_mean: np.ndarray
    landmark_basis_times_sd: np.ndarray
    shape_gram: np.ndarray
    _: KW_ONLY
    standardise: str = "face"
    schedule: str = "constant"
    learning_rate: float = 1e-3
    epochs: int = 200
    steps_per_epoch: int = 500
    batch_size: int = 16
    seed: int = 0

    def fit(self, images, coefficients: np.ndarray, **training) -> Self:
        """Train on images of faces with known coefficients.

        Args:
            images: `(n, 96, 96, 3)` uint8, an array or something indexed like one; read one
                mini-batch at a time.
            coefficients: `(n, K)` standard-normal identity coefficients.

        Raises:
            InputError: Unequal numbers, NaN, a single component, or a checkpoint of another run.
        """
        self._check_parameters()
        basis, name = self.landmark_basis_times_sd, "landmark_basis_times_sd"
        n, n_coefficients = len(images), len(check_basis(basis, name, len(self.landmark_mean), 2))
        check_shape(coefficients, "coefficients", (n, n_coefficients))
        check_shape(self.shape_gram, "shape_gram", (n_coefficients, n_coefficients))
        if not np.isfinite(as_numbers(coefficients, "coefficients")).all():
            raise InputError("coefficients must be finite. Received NaN or infinity.")
        coefficients, check = np.asarray(coefficients, np.float32), np.arange(min(n, _CHECK_FACES))
        steps, batch = self.steps_per_epoch, self.batch_size
        recipe, loss = Recipe(self.epochs, steps, self.schedule, self.learning_rate), self._loss()
        network = self._compiled(recipe.optimizer(steps), loss)

        def mini_batches(epoch: int) -> dict:
            order = face_order(n, steps * batch, self.seed, epoch).reshape(steps, batch)
            return {"x": image_batches(images, coefficients, order)}

        def inference() -> float:
            raw = forward_images(network, images[check], _IMAGES_PER_CALL)
            return float(np.mean(loss(coefficients[check], raw)))

        return self._train(network, mini_batches, (images, coefficients), inference, **training)

    def predict(self, images: np.ndarray) -> np.ndarray:
        """Landmarks of the faces in images, in the frame of the face model: frontal.

        Images `(n, 96, 96, 3)` uint8 give `(n, L, 3)` millimetres.

        Raises:
            InputError: Not trained, or images of another kind or size.
        """
        network = self._trained()
        raw = forward_images(network, check_images(images, IMAGE_SIZE), _IMAGES_PER_CALL)
        coefficients = np.asarray(_standardised(raw, "face"))
        return self.landmark_mean + np.tensordot(coefficients, self.landmark_basis_times_sd, 1)

    def _build(self, seed: int = 0) -> keras.Model:
        return build_mobileface_net(len(self.landmark_basis_times_sd), seed=seed)

    def _loss(self) -> Callable:
        """Mean squared error over all coordinates of the mesh, from coefficients."""
        gram, over = np.float32(self.shape_gram), self.standardise
        check_choice(over, "standardise", ("face", "batch"))

        def mean_squared_error_of_shapes(true_coefficients, raw):
            difference = _standardised(raw, over) - true_coefficients
            return ops.sum(ops.matmul(difference, gram) * difference, axis=1)

        return mean_squared_error_of_shapes


def build_mobileface_net(n_coefficients: int = 199, *, seed: int = 0) -> keras.Model:
    """MobileNet of width 0.3125 without its head, and one dense layer on all of its last map.

    Args:
        n_coefficients: Components of the face model. The Basel model's 199 give 900,979 trainable
            parameters of 907,819.
        seed: Seed of the initial weights.

    Returns:
        Model from `(n, 96, 96, 3)` images in [-1, 1] to `(n, n_coefficients)`.
    """
    check_fork("Keras")
    size = (IMAGE_SIZE, IMAGE_SIZE, 3)
    body = keras.applications.MobileNet(size, alpha=0.3125, include_top=False, weights=None)
    features = layers.Flatten(name="features")(body.output)
    raw = layers.Dense(n_coefficients, name="coefficients")(features)
    net = keras.Model(body.input, raw, name=f"mobileface_{n_coefficients}")
    draw_kernels(net, seed)
    return net


def _standardised(raw, over: str):
    """Mean 0 and s.d. 1 over each face, or over the whole batch."""
    axis = 1 if over == "face" else None
    mean, sd = ops.mean(raw, axis, keepdims=True), ops.std(raw, axis, keepdims=True)
    return (raw - mean) / sd
