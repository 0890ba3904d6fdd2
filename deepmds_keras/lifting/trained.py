"""What a trained lifting network does, by NumPy alone: shapes, standard deviations and cameras."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from deepmds_keras.checks import check_fitted
from deepmds_keras.errors import InputError
from deepmds_keras.files import read_arrays
from deepmds_keras.landmarks.y_axis import check_views
from deepmds_keras.lifting.equations import Camera
from deepmds_keras.lifting.network import SIZES, UNIT, Lift, check_weights, lift
from deepmds_keras.lifting.views import Views, prepare_views

_CHUNK = 250  # faces at a time, whose arrays stay in the cache
SETTERS = "fit, load or pretrained"


class Pose(NamedTuple):
    """The cameras that see faces, of `n` views.

    Attributes:
        rotation: `(n, 3, 3)`, to be multiplied from the left: from the frame of the shapes to that
            of the camera, +x to the right of the view, +y up, +z towards the viewer.
        scale: `(n,)` units of the view for a unit of the shape, at the depth of its centre.
        translation: `(n, 2)` where the centre of the shape is seen.
        perspective: `(n,)` one over the distance of the camera, in units of the shape; 0 for an
            orthographic camera.
    """

    rotation: np.ndarray
    scale: np.ndarray
    translation: np.ndarray
    perspective: np.ndarray

    def project(self, shapes: np.ndarray) -> np.ndarray:
        """Views of shapes: `(n, L, 3)` → `(n, L, 2)`, y up."""
        posed = shapes @ np.swapaxes(self.rotation, 1, 2)
        near = 1 / (1 - self.perspective[:, None, None] * posed[..., 2:])
        seen = self.scale[:, None, None] * near * posed[..., :2]
        return seen + self.translation[:, None]


def read_lifter(path: str | Path) -> tuple[dict[str, np.ndarray], dict]:
    """Weights of a file of `LandmarkLifter.save`, and what it says of them.

    Raises:
        InputError: Missing or damaged file, or weights of another network.
    """
    arrays, described = read_arrays(path)
    try:
        own = described["parameters"]
        check_weights(arrays, own["n_landmarks"], SIZES[own["size"]])
        float(described["training_sd"]), described["history"]
    except (KeyError, TypeError, ValueError) as error:
        raise not_a_lifter(path, error) from None
    return {name: np.float32(array) for name, array in arrays.items()}, described


def not_a_lifter(path: str | Path, error: Exception) -> InputError:
    return InputError(f"{path} was not written by LandmarkLifter.save(): {error}.")


class TrainedLifter:
    """The part of `LandmarkLifter` that predicts, which needs no scikit-learn.

    Attributes:
        n_landmarks: L.
        size: One of `SIZES`.
        weights_: Trained arrays by name.
        training_sd_: Standard deviation of the landmarks in training, in units of the root mean
            square radius.
    """

    def __init__(
        self, n_landmarks: int, size: str, weights: dict[str, np.ndarray], training_sd: float
    ):
        self.n_landmarks, self.size = n_landmarks, size
        self.weights_, self.training_sd_ = weights, training_sd

    @staticmethod
    def read(path: str | Path) -> TrainedLifter:
        """Read what `LandmarkLifter.save` wrote.

        Raises:
            InputError: Missing or damaged file, or weights of another network.
        """
        arrays, described = read_lifter(path)
        own = described["parameters"]
        return TrainedLifter(own["n_landmarks"], own["size"], arrays, described["training_sd"])

    def predict(
        self,
        views: np.ndarray,
        *,
        landmark_sd: float | np.ndarray | None = None,
        visible: np.ndarray | None = None,
        return_std: bool = False,
        check_orientation: bool = True,
    ) -> np.ndarray | tuple[np.ndarray, np.ndarray]:
        """3D landmarks of each view, by NumPy alone.

        Args:
            views: `(n, L, 2)` or `(L, 2)` landmarks in the image, y up, any scale and place. A
                landmark with a coordinate that is NaN is missing.
            landmark_sd: Standard deviation of the errors of a coordinate, in the unit of the
                views: one number, one for each face `(n,)` or for each landmark `(n, L)`. None
                takes them to be as in training.
            visible: `(n, L)` or `(L,)` bool, False where a landmark is missing, whatever `views`
                has there.
            return_std: Whether to return standard deviations, too.
            check_orientation: Whether to refuse views of a known landmark scheme that are upside
                down or mirrored.

        Returns:
            `(n, L, 3)` frontal shapes, missing landmarks included: +x to the subject's left, +y
            up, +z out of the face, in the unit of `normalise`; true size cannot be seen in one
            view. The mean of the landmarks is about 0. With `return_std`, also `(n, L, 3)`
            standard deviations of the errors, where the mean of the true landmarks is 0.

        Raises:
            InputError: Another number of landmarks, infinity, or not six visible landmarks that
                are not on one line; `visible` or `landmark_sd` of another shape; wrong
                orientation.
        """
        seen = prepare_views(views, self.n_landmarks, visible, landmark_sd)
        if check_orientation:
            check_views(seen.points)
        lifted = self._lift(seen)
        shapes = np.concatenate([part.shapes for part in lifted]).swapaxes(1, 2)
        if not return_std:
            return shapes
        log_sd = np.concatenate([part.log_sd for part in lifted]).swapaxes(1, 2)
        return shapes, UNIT * np.exp(log_sd)

    def pose(
        self,
        views: np.ndarray,
        *,
        landmark_sd: float | np.ndarray | None = None,
        visible: np.ndarray | None = None,
    ) -> Pose:
        """The cameras that see the faces, as the last step solved for them.

        Args:
            views, landmark_sd, visible: As for `predict`.

        Raises:
            InputError: As for `predict`.
        """
        seen = prepare_views(views, self.n_landmarks, visible, landmark_sd)
        lifted = self._lift(seen)
        camera = Camera(*map(np.concatenate, zip(*(part.camera for part in lifted), strict=True)))
        return Pose(
            rotation=camera.rotation,
            scale=(camera.scale * seen.radius)[:, 0],
            translation=camera.shift * seen.radius + seen.centre,
            perspective=camera.perspective[:, 0],
        )

    @property
    def n_parameters(self) -> int:
        return sum(array.size for array in check_fitted(self, "weights_", SETTERS).values())

    def _lift(self, seen: Views) -> list[Lift]:
        arrays = check_fitted(self, "weights_", SETTERS)
        sd = np.full_like(seen.visible, self.training_sd_) if seen.sd is None else seen.sd
        inputs = (seen.views, seen.visible, sd)
        iterations = SIZES[self.size].iterations
        chunks = [slice(i, i + _CHUNK) for i in range(0, len(sd), _CHUNK)]
        return [lift(np, arrays, iterations, *(a[c] for a in inputs)) for c in chunks]
