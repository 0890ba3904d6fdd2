"""A multilayer perceptron from a view to the shape, which a structured network must beat."""

from dataclasses import KW_ONLY, dataclass
from typing import Self

import keras
import numpy as np

from deepmds_keras.baselines.base import NetworkMethod, dense_network
from deepmds_keras.geometry.units import centre_to_radius_1
from deepmds_keras.networks import forward
from deepmds_keras.training import Recipe
from deepmds_keras.validation import (
    check_faces,
    check_n_landmarks,
    check_views_and_shapes,
    of_one_or_many,
)

_UNIT = 0.01  # unit of the output, in which faces differ by about 1


@dataclass(eq=False, repr=False)
class MLP(NetworkMethod):
    """Two hidden layers with ReLU, from a centred and scaled view to all coordinates of the shape.

    Each number of a view is standardised over the training faces: otherwise the pose outweighs the
    face, and the error on the open head is three times as large. With 60 units and 72 landmarks it
    has 25,536 parameters, about as many as the lifting network. It is trained for as many steps, by
    Adam with a cosine schedule, in mini-batches of 128 faces.

    Args:
        n_landmarks: L.
        units: Units of each hidden layer.
    """

    n_landmarks: int = 72
    _: KW_ONLY
    units: int = 60
    learning_rate: float = 5e-3
    epochs: int = 20
    steps_per_epoch: int = 300
    batch_size: int = 128
    seed: int = 0

    def fit(self, views: np.ndarray, shapes: np.ndarray, **training) -> Self:
        """Train on `(n, L, 2)` views, any scale and place, and `(n, L, 3)` shapes in one frame.

        Raises:
            InputError: NaN, infinity, degenerate or another number of landmarks, or a checkpoint
                of another run.
        """
        self._check_parameters()
        views, shapes = check_views_and_shapes(views, shapes)
        check_faces(views, "views", 2, self.n_landmarks)
        views, shapes = _flat(views), np.float32(shapes).reshape(len(shapes), -1) / _UNIT
        recipe = Recipe(self.epochs, schedule="cosine", learning_rate=self.learning_rate)
        network = self._compiled(recipe.optimizer(self.steps_per_epoch), "mse")
        network.get_layer("standardised").set_weights([views.mean(0), views.var(0)])
        network.layers[-1].bias.assign(shapes.mean(0))
        return self._train_on_arrays(network, views, shapes, **training)

    def predict(self, views: np.ndarray) -> np.ndarray:
        """Shapes of the views, in the frame and unit of the training.

        `(n, L, 2)` gives `(n, L, 3)`, and one view `(L, 2)` gives `(L, 3)`.

        Raises:
            InputError: Not trained, or NaN, infinity, degenerate or another number of landmarks.
        """
        network = self._trained()
        flat = _flat(check_faces(views, "views", 2, self.n_landmarks))
        shapes = _UNIT * forward(network, flat).reshape(-1, self.n_landmarks, 3)
        return of_one_or_many(shapes, views)

    def _build(self, seed: int = 0) -> keras.Model:
        check_n_landmarks(self.n_landmarks)
        hidden = self.units, "relu"
        sizes = {"hidden_1": hidden, "hidden_2": hidden, "shape": (3 * self.n_landmarks, None)}
        name = f"mlp_{self.n_landmarks}"
        return dense_network(name, 2 * self.n_landmarks, sizes, seed, standardised=True)


def _flat(views: np.ndarray) -> np.ndarray:
    return np.float32(centre_to_radius_1(views)).reshape(len(views), -1)
