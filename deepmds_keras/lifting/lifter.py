"""The lifting network as one estimator: views of a face in, its 3D landmarks out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from sklearn.base import BaseEstimator

from deepmds_keras import weights
from deepmds_keras.checks import check_fitted
from deepmds_keras.io.errors import InputError
from deepmds_keras.lifting.equations import Camera
from deepmds_keras.lifting.faces import GivenFaces, SampledFaces, read_faces
from deepmds_keras.lifting.network import (
    SIZES,
    UNIT,
    Lift,
    check_weights,
    initial_weights,
    lift,
)
from deepmds_keras.lifting.views import LEAST_VISIBLE, Views, prepare_views

_CHUNK = 250  # faces at a time, whose arrays stay in the cache
_SETTERS = "fit, load or pretrained"


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


class LandmarkLifter(BaseEstimator):
    """3D landmarks of a face from the 2D landmarks of one image, by a network that knows cameras.

    The network is a fit of a face model that is learnt with it, cut short: a few steps that solve
    for the camera and, by conjugate gradients, for the coefficients of the shape, then a learnt
    correction. It stands in the line of cascaded regression (Xiong and De la Torre 2013,
    doi:10.1109/CVPR.2013.75) and of optimisers that are learnt (Gregor and LeCun 2010; Song, Chen
    and Hilliges 2020; for morphable models Choutas et al. 2021, arXiv:2111.14824). To turn a view
    in its plane, scale or move it changes nothing; landmarks may be missing.

    Args:
        n_landmarks: L, at least 6.
        size: `"small"` (at 72 landmarks fewer parameters than Deep-MDS) or `"large"`.
        steps: Mini-batches to train for.
        batch_size: Faces in a mini-batch.
        learning_rate: Of Adam at the start; a cosine takes it to 0.
        missing: Largest share of the landmarks that are hidden in training; for each face a share
            up to it is drawn, then the landmarks.
        noise: Largest standard deviation of errors that are added to the landmarks in training,
            in units of the root mean square radius of the view; for each face one up to it is
            drawn, and told to the network.
        seed: Of weights, order of the faces, missing landmarks and noise.

    Attributes:
        weights_: Trained arrays by name.
        training_sd_: Standard deviation of the landmarks in training, in units of the root mean
            square radius: what `predict` takes where it is not told.
        history_: Losses by block of 100 steps.
        n_parameters: Trainable parameters, all of `weights_`.
    """

    def __init__(
        self,
        n_landmarks: int = 72,
        size: str = "small",
        *,
        steps: int = 4000,
        batch_size: int = 128,
        learning_rate: float = 2e-3,
        missing: float = 0.0,
        noise: float = 0.0,
        seed: int = 0,
    ):
        self.n_landmarks = n_landmarks
        self.size = size
        self.steps = steps
        self.batch_size = batch_size
        self.learning_rate = learning_rate
        self.missing = missing
        self.noise = noise
        self.seed = seed

    def fit(
        self,
        views: np.ndarray | Callable,
        shapes: np.ndarray | None = None,
        *,
        landmark_sd: float | np.ndarray | None = None,
        progress: Callable[[dict], object] | None = None,
        checkpoint: str | Path | None = None,
    ) -> LandmarkLifter:
        """Train on faces that are given, or that are sampled as they are needed.

        Args:
            views: `(n, L, 2)` landmarks in the image, y up, any scale and place, NaN where one is
                missing; or a function of a number of faces and a `numpy.random.Generator` that
                returns views, shapes and `landmark_sd`, as they would be given here.
            shapes: `(n, L, 3)` true landmarks, +z out of the face, any scale. A tenth of the faces,
                at most 1,000, is held out, and the weights that do best on them are kept.
            landmark_sd: Standard deviation of the errors that the landmarks already have, in the
                unit of the views, as for `predict`; None for exact ones.
            progress: Called after every 100 steps with the losses.
            checkpoint: File to go on from after a stop, and to write after every 100 steps.

        Raises:
            InputError: Wrong number of landmarks, unequal numbers of faces, infinity, a face with
                too few landmarks, an option out of range, or the checkpoint of another run.
        """
        from deepmds_keras.lifting.training import Recipe, train_lifting_net

        self._check_parameters()
        if callable(views):
            if shapes is not None or landmark_sd is not None:
                raise InputError(
                    "shapes and landmark_sd must be left out where views is a function, which "
                    "returns them. Received one of them."
                )
            faces = SampledFaces(views, self.n_landmarks, self.missing, self.noise, self.seed)
        else:
            given = read_faces(views, shapes, landmark_sd, self.n_landmarks)
            faces = GivenFaces(given, self.missing, self.noise, self.seed)
        size = SIZES[self.size]
        self.weights_, self.history_ = train_lifting_net(
            initial_weights(faces.shapes, size, self.seed),
            size.iterations,
            faces.block,
            faces.held_out,
            Recipe(self.steps, self.batch_size, self.learning_rate),
            label={**self.get_params(), "faces": faces.number},
            checkpoint=checkpoint,
            progress=progress,
        )
        self.training_sd_ = float(faces.held_out.sd.mean())
        return self

    def predict(
        self,
        views: np.ndarray,
        *,
        landmark_sd: float | np.ndarray | None = None,
        visible: np.ndarray | None = None,
        return_std: bool = False,
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

        Returns:
            `(n, L, 3)` frontal shapes, missing landmarks included: +x to the subject's left, +y
            up, +z out of the face, in the unit of `normalise`; true size cannot be seen in one
            view. The mean of the landmarks is about 0. With `return_std`, also `(n, L, 3)`
            standard deviations of the errors, where the mean of the true landmarks is 0.

        Raises:
            InputError: Another number of landmarks, infinity, or not six visible landmarks that
                are not on one line; `visible` or `landmark_sd` of another shape.
        """
        lifted, _ = self._lift(views, landmark_sd, visible)
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
        lifted, seen = self._lift(views, landmark_sd, visible)
        camera = Camera(*map(np.concatenate, zip(*(part.camera for part in lifted), strict=True)))
        return Pose(
            rotation=camera.rotation,
            scale=(camera.scale * seen.radius)[:, 0],
            translation=camera.shift * seen.radius + seen.centre,
            perspective=camera.perspective[:, 0],
        )

    def save(self, path: str | Path) -> None:
        """Write parameters and weights into one `.npz` file, complete or not at all."""
        arrays = check_fitted(self, "weights_", _SETTERS)
        described = {
            "parameters": self.get_params(),
            "training_sd": self.training_sd_,
            "history": self.history_,
        }
        weights.write_arrays(path, arrays, described)

    @classmethod
    def load(cls, path: str | Path) -> LandmarkLifter:
        """Read what `save` wrote.

        Raises:
            InputError: Missing or damaged file, or weights of another network.
        """
        arrays, described = weights.read_arrays(path)
        try:
            lifter = cls(**described["parameters"])
            lifter._check_parameters()
            lifter.training_sd_ = float(described["training_sd"])
            lifter.history_ = described["history"]
            check_weights(arrays, lifter.n_landmarks, SIZES[lifter.size])
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{path} was not written by LandmarkLifter.save(): {error}.") from None
        lifter.weights_ = {name: np.float32(array) for name, array in arrays.items()}
        return lifter

    @classmethod
    def pretrained(cls, name: str) -> LandmarkLifter:
        """The weights that ship with the package.

        Raises:
            InputError: No weights of that name.
        """
        return cls.load(weights.pretrained_path(name))

    @property
    def n_parameters(self) -> int:
        return sum(array.size for array in check_fitted(self, "weights_", _SETTERS).values())

    def _lift(self, views, landmark_sd, visible) -> tuple[list[Lift], Views]:
        arrays = check_fitted(self, "weights_", _SETTERS)
        seen = prepare_views(views, self.n_landmarks, visible, landmark_sd)
        sd = np.full_like(seen.visible, self.training_sd_) if seen.sd is None else seen.sd
        inputs = (seen.views, seen.visible, sd)
        iterations = SIZES[self.size].iterations
        chunks = [slice(i, i + _CHUNK) for i in range(0, len(sd), _CHUNK)]
        return [lift(np, arrays, iterations, *(a[c] for a in inputs)) for c in chunks], seen

    def _check_parameters(self):
        if self.size not in SIZES:
            raise InputError(f"size must be one of {', '.join(SIZES)}. Received {self.size!r}.")
        if self.n_landmarks < LEAST_VISIBLE:
            raise InputError(
                f"n_landmarks must be at least {LEAST_VISIBLE}. Received {self.n_landmarks}."
            )
        for name in ("steps", "batch_size", "learning_rate"):
            if not getattr(self, name) > 0:
                raise InputError(f"{name} must be positive. Received {getattr(self, name)}.")
        if not 0 <= self.missing < 1:
            raise InputError(f"missing must be in [0, 1). Received {self.missing}.")
        if not 0 <= self.noise < np.inf:
            raise InputError(f"noise must be finite and not negative. Received {self.noise}.")
