"""Landmark depth by a dense network, after Zhao et al. 2017 as the paper's authors trained it."""

from dataclasses import KW_ONLY, dataclass
from typing import Self

import keras
import numpy as np

from deepmds_keras.baselines.base import NetworkMethod, dense_network
from deepmds_keras.errors import check_choice
from deepmds_keras.networks import forward
from deepmds_keras.validation import check_faces, check_n_landmarks, of_one_or_many


@dataclass(eq=False, repr=False)
class Zhao(NetworkMethod):
    """Depth of each landmark in the camera's frame; x and y are the view itself.

    Zhao et al. 2017, arXiv:1609.09058, in the topology and recipe of the paper's authors: MSE, and
    each face in its unit of `normalise_view`. In that unit a frontal depth just fits into the range
    of tanh; that of a face turned by 45 degrees does not. The paper says that Adam trained all
    networks; the authors' code used RMSprop for this one.

    Shapes come out with x, y and depth in that same unit. The authors' evaluator instead rescales
    the predicted depth to [0, 1] by itself and joins it to the true x and y, whose depth spans
    about 0.4: scored so even a perfect depth has an MSE of 2.1e-3, which is the number that the
    paper reports for this method.

    Args:
        n_landmarks: L.
        optimizer: `"adam"` or `"rmsprop"`.
    """

    n_landmarks: int = 72
    _: KW_ONLY
    optimizer: str = "adam"
    learning_rate: float = 1e-3
    epochs: int = 10
    steps_per_epoch: int = 1000
    batch_size: int = 16
    seed: int = 0

    def fit(self, points: np.ndarray, **training) -> Self:
        """Train on faces in the camera's frame.

        Args:
            points: `(n, L, 3)`: x and y as in the view and, in the same frame and unit, depth
                towards the viewer.

        Raises:
            InputError: NaN, infinity, degenerate or another number of landmarks, another optimiser,
                or a checkpoint of another run.
        """
        self._check_parameters()
        check_choice(self.optimizer, "optimizer", ("adam", "rmsprop"))
        points = check_faces(points, "points", 3, self.n_landmarks)
        centred = points - points.mean(1, keepdims=True)
        views, size = normalise_view(points[..., :2])
        views = np.float32(views).reshape(len(points), -1)
        depths = np.float32(centred[..., 2] / size[..., 0])
        rate = {"learning_rate": float(self.learning_rate)}
        options = {"class_name": self.optimizer, "config": rate}
        network = self._compiled(keras.optimizers.get(options), "mse")
        return self._train_on_arrays(network, views, depths, **training)

    def predict(self, views: np.ndarray) -> np.ndarray:
        """Shapes in the camera's frame, of views of any scale and place.

        `(n, L, 2)` gives `(n, L, 3)`, and one view `(L, 2)` gives `(L, 3)`: normalised x and y, and
        depth towards the viewer in the same unit.

        Raises:
            InputError: Not trained, or NaN, infinity, degenerate or another number of landmarks.
        """
        network = self._trained()
        faces, _ = normalise_view(check_faces(views, "views", 2, self.n_landmarks))
        depths = forward(network, np.float32(faces).reshape(len(faces), -1))
        return of_one_or_many(np.concatenate([faces, depths[..., None]], axis=2), views)

    def _build(self, seed: int = 0) -> keras.Model:
        return build_zhao_net(self.n_landmarks, seed=seed)


def build_zhao_net(n_landmarks: int = 72, *, seed: int = 0) -> keras.Model:
    """Five hidden dense layers as wide as the input and a dense output, all with tanh.

    Args:
        n_landmarks: L. 72 gives 114,840 parameters (the paper's number), 51 gives 57,783.
        seed: Seed of the initial weights.

    Returns:
        Model from `(n, 2L)` coordinates x1, y1, x2, … to `(n, L)` depths.

    Raises:
        InputError: No whole number of landmarks, or fewer than 3.
    """
    check_n_landmarks(n_landmarks)
    width = 2 * n_landmarks
    sizes = {f"hidden_{number}": (width, "tanh") for number in range(1, 6)}
    sizes["depth"] = n_landmarks, "tanh"
    return dense_network(f"zhao_{n_landmarks}", width, sizes, seed)


def normalise_view(views: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Views `(n, L, 2)` centred and divided by std(x) + std(y), and these divisors, `(n, 1, 1)`."""
    size = views.std(1).sum(1)[:, None, None]
    return (views - views.mean(1, keepdims=True)) / size, size
