"""Landmark depth by a dense network, after Zhao et al. 2017 as the paper's authors trained it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from pathlib import Path

import keras
import numpy as np
import tensorflow as tf

from deepmds_keras.baselines.networks import NetworkMethod, build_zhao_net
from deepmds_keras.checks import check_faces
from deepmds_keras.errors import InputError
from deepmds_keras.networks import forward
from deepmds_keras.training import face_order, steps_per_call

OPTIMIZERS = ("adam", "rmsprop")


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
        learning_rate: Of the optimiser.
        epochs: Rounds of `steps_per_epoch` mini-batches.
        steps_per_epoch: Mini-batches in an epoch.
        batch_size: Faces in a mini-batch.
        seed: Of the initial weights and the order of the faces.
    """

    n_landmarks: int = 72
    _: KW_ONLY
    optimizer: str = "adam"
    learning_rate: float = 1e-3
    epochs: int = 10
    steps_per_epoch: int = 1000
    batch_size: int = 16
    seed: int = 0

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
            checkpoint, progress: As for `train_by_epoch`.

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
        n, steps, batch = len(points), self.steps_per_epoch, self.batch_size
        network = self._build(self.seed)
        optimizer = keras.optimizers.get(
            {"class_name": self.optimizer, "config": {"learning_rate": self.learning_rate}}
        )
        network.compile(optimizer, "mse", steps_per_execution=steps_per_call(steps))

        def batches(epoch: int) -> tf.data.Dataset:
            faces = face_order(n, steps * batch, self.seed, epoch).reshape(steps, batch)
            return tf.data.Dataset.from_tensor_slices((views[faces], depths[faces]))

        def inference() -> float:
            predicted = forward(network, views)
            return float(np.mean((predicted - depths) ** 2))

        return self._train(network, batches, {"faces": n}, inference, checkpoint, progress)

    def predict(self, views: np.ndarray) -> np.ndarray:
        """Shapes in the camera's frame.

        Args:
            views: `(n, L, 2)`, any scale and place.

        Returns:
            `(n, L, 3)` normalised x and y, and depth towards the viewer in the same unit.

        Raises:
            InputError: Not trained, or NaN, infinity, degenerate or another number of landmarks.
        """
        network = self._trained()
        views, _ = normalise_view(check_faces(views, "views", 2, self.n_landmarks))
        depths = forward(network, np.float32(views).reshape(len(views), -1))
        return np.concatenate([views, depths[..., None]], axis=2)

    def _build(self, seed: int = 0) -> keras.Model:
        return build_zhao_net(self.n_landmarks, seed=seed)


def normalise_view(views: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Views `(n, L, 2)` centred and divided by std(x) + std(y), and these divisors, `(n, 1, 1)`."""
    size = views.std(1).sum(1)[:, None, None]
    return (views - views.mean(1, keepdims=True)) / size, size
