"""A plain dense network from a view to the shape: what a structured network has to beat."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

import keras
import numpy as np
import tensorflow as tf
from keras import layers

from deepmds_keras.alignment import centre, rms_radius
from deepmds_keras.baselines.networks import NetworkMethod
from deepmds_keras.checks import check_faces, check_n_landmarks, check_views_and_shapes
from deepmds_keras.networks import forward
from deepmds_keras.training import Recipe, face_order

_UNIT = 0.01  # of what the network returns, in which faces differ by about 1


@dataclass(eq=False, repr=False)
class Perceptron(NetworkMethod):
    """Two hidden layers with ReLU, from a view that is centred and scaled to all coordinates.

    With 60 units and 72 landmarks it has 25,536 parameters, about as many as the lifting network.
    It is trained for as many steps: by Adam with a cosine schedule, in mini-batches of 128 faces.

    Args:
        n_landmarks: L.
        units: Of a hidden layer.
        learning_rate: Of Adam, at the start.
        epochs, steps_per_epoch: Rounds of training, and mini-batches in each.
        batch_size: Faces in a mini-batch.
        seed: Of the initial weights and the order of the faces.
    """

    n_landmarks: int = 72
    _: KW_ONLY
    units: int = 60
    learning_rate: float = 5e-3
    epochs: int = 20
    steps_per_epoch: int = 300
    batch_size: int = 128
    seed: int = 0

    def fit(self, views: np.ndarray, shapes: np.ndarray, **training) -> Perceptron:
        """Train on `(n, L, 2)` views, any scale and place, and `(n, L, 3)` shapes in one frame.

        Args:
            views, shapes: The faces.
            training: `checkpoint` and `progress`, as for `train_by_epoch`.

        Raises:
            InputError: NaN, infinity, degenerate or another number of landmarks, or a checkpoint
                of another run.
        """
        views, shapes = check_views_and_shapes(views, shapes)
        n, steps, batch = len(shapes), self.steps_per_epoch, self.batch_size
        views, shapes = self._flat(views), np.float32(shapes).reshape(n, -1) / _UNIT
        recipe = Recipe(self.epochs, steps, "cosine", self.learning_rate)
        network = self._compiled(recipe.optimizer(steps), "mse")
        network.layers[-1].bias.assign(shapes.mean(0))

        def batches(epoch: int) -> tf.data.Dataset:
            faces = face_order(n, steps * batch, self.seed, epoch).reshape(steps, batch)
            return tf.data.Dataset.from_tensor_slices((views[faces], shapes[faces]))

        def inference() -> float:
            return float(np.mean((forward(network, views) - shapes) ** 2))

        return self._train(network, batches, {"faces": n}, inference, **training)

    def predict(self, views: np.ndarray) -> np.ndarray:
        """`(n, L, 3)` shapes of `(n, L, 2)` views, in the frame and unit of the training.

        Raises:
            InputError: Not trained, or NaN, infinity, degenerate or another number of landmarks.
        """
        network = self._trained()
        return _UNIT * forward(network, self._flat(views)).reshape(-1, self.n_landmarks, 3)

    def _flat(self, views: np.ndarray) -> np.ndarray:
        views = check_faces(views, "views", 2, self.n_landmarks)
        scaled = centre(views) / rms_radius(views)[:, None, None]
        return np.float32(scaled).reshape(len(views), -1)

    def _build(self, seed: int = 0) -> keras.Model:
        check_n_landmarks(self.n_landmarks)
        view = x = keras.Input((2 * self.n_landmarks,), name="view")
        sizes = {"hidden_1": self.units, "hidden_2": self.units, "shape": 3 * self.n_landmarks}
        for number, (name, units) in enumerate(sizes.items()):
            initial = keras.initializers.GlorotUniform(seed=1000 * seed + number)
            activation = None if name == "shape" else "relu"
            x = layers.Dense(units, activation, kernel_initializer=initial, name=name)(x)
        return keras.Model(view, x, name=f"perceptron_{self.n_landmarks}")
