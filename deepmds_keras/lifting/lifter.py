"""The lifting network as one estimator: views of a face in, its 3D landmarks out.

Predicting needs NumPy alone; `fit` imports Keras, and scikit-learn is imported only by its users.
"""

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, fields
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self, overload

import numpy as np

from deepmds_keras import weights
from deepmds_keras.errors import InputError, check_choice, needs
from deepmds_keras.files import read_arrays, write_arrays
from deepmds_keras.geometry.camera import HeadPose
from deepmds_keras.landmarks.y_axis import check_views
from deepmds_keras.lifting.equations import Camera
from deepmds_keras.lifting.inputs import LEAST_VISIBLE, Views, prepare_views
from deepmds_keras.lifting.sampling import given_faces, read_faces, sampled_faces
from deepmds_keras.lifting.unrolled_fit import UNIT, check_weights, initial_weights, lift
from deepmds_keras.metrics import explained_share
from deepmds_keras.validation import (
    check_fitted,
    check_n_landmarks,
    check_number,
    check_still_of,
    check_whole,
)
from deepmds_keras.weights import fingerprint

# Standard deviation of landmarks that `predict` assumes by default, in r.m.s. radii of the view:
# about 1 % of the distance between the outer corners of the eyes, for 51 or 72 landmarks.
DEFAULT_SD = 0.025
_CHUNK = 250  # faces at a time, whose arrays stay in the cache
_SETTERS = "fit, load or pretrained"
_MEAN_SHAPE = "mean_shape"
_SHIPPED = "lifting-"  # prefix of the files of shipped weights


class Estimate(NamedTuple):
    """Faces as a lifter estimates them.

    Attributes:
        shapes: `(n, L, 3)`, or `(L, 3)` for one view, as `LandmarkLifter.predict` returns them.
        std: Standard deviations of the errors of the shapes, as many.
        pose: The n cameras, or the one, as solved for in the last step.
    """

    shapes: np.ndarray
    std: np.ndarray
    pose: HeadPose


@dataclass(eq=False)
class LandmarkLifter:
    """3D landmarks of a face from the 2D landmarks of one image, by a network that solves cameras.

    The network is an unrolled fit of a face model that is learnt with it: a few steps that solve
    for the camera and, by conjugate gradients, for the coefficients of the shape, then a learnt
    correction. It follows cascaded regression (Xiong and De la Torre 2013,
    doi:10.1109/CVPR.2013.75) and learnt optimisers (Gregor and LeCun 2010; Song, Chen and Hilliges
    2020; for morphable models Choutas et al. 2021, arXiv:2111.14824). The result is invariant to
    rotating a view in its plane, scaling and moving it; landmarks may be missing.

    Args:
        n_landmarks: L, at least 6.
        steps: Number of mini-batches.
        batch_size: Faces per mini-batch.
        learning_rate: Adam's initial learning rate; it decays to 0 along a cosine.
        missing: Largest share of landmarks hidden in training; each face draws a share up to it,
            then the landmarks.
        noise: Largest standard deviation of the errors added to the landmarks in training, in
            units of the root mean square radius of the view; each face draws one up to it, which
            the network gets as an input.
        seed: Seed of weights, order of the faces, missing landmarks and noise.

    Attributes:
        weights_: Trained arrays by name.
        mean_shape_: `(L, 3)` mean of the training faces, in the unit of `predict`; None if read
            from a file of before version 0.4, which lacks it.
        default_sd_: Standard deviation that `predict` assumes if none is given, in units of the
            root mean square radius: `DEFAULT_SD`, or the mean in training if that is less.
        history_: Losses of each block of 100 steps.
        n_parameters: Number of trainable parameters, all of `weights_`.

    Landmarks are in the order of a scheme, `load_scheme("ibug51").names` (docs/landmarks.md).
    Weights ship for `"ibug51"`, `"ibug68"` and `"bfm72"`. It works with scikit-learn's `clone`,
    `Pipeline`, `cross_val_score` and `GridSearchCV`.

    Examples:
        >>> from deepmds_keras import LandmarkLifter
        >>> lifter = LandmarkLifter.pretrained("ibug51")
        >>> face = lifter.mean_shape_  # (51, 3)
        >>> shapes, sd = lifter.predict(face[:, :2], return_std=True)  # y up
        >>> shapes.shape, sd.shape
        ((51, 3), (51, 3))
        >>> brow, mouth = shapes[:10, 1].mean(), shapes[31:, 1].mean()
        >>> bool(brow > mouth)
        True
    """

    n_landmarks: int = 72
    _: KW_ONLY
    steps: int = 4000
    batch_size: int = 128
    learning_rate: float = 2e-3
    missing: float = 0.0
    noise: float = 0.0
    seed: int = 0

    def fit(
        self,
        views: np.ndarray | Callable,
        shapes: np.ndarray | None = None,
        *,
        landmark_sd: float | np.ndarray | None = None,
        progress: Callable[[dict], object] | None = None,
        checkpoint: str | Path | None = None,
    ) -> Self:
        """Train on given faces, or on faces that a function samples.

        Args:
            views: `(n, L, 2)` landmarks in the image, y up, any scale and place, NaN where one is
                missing; or a function of a number of faces and a `numpy.random.Generator` that
                returns views, shapes and `landmark_sd` as described here.
            shapes: `(n, L, 3)` true landmarks, +z out of the face, any scale and place. A tenth of
                the different shapes, of at most 1,000 faces, is held out, and the weights that do
                best on them are kept.
            landmark_sd: Standard deviation of the errors that the landmarks already have, in the
                unit of the views, as for `predict`; None if they are exact.
            progress: Called after every 100 steps with the losses.
            checkpoint: File to resume from, written after every 100 steps.

        Raises:
            InputError: Wrong number of landmarks, unequal numbers of faces, infinity, a face with
                too few landmarks, an option out of range, or the checkpoint of another run.

        Warns:
            UserWarning: Fewer than 50 different shapes were given.
        """
        with needs("Keras with TensorFlow, which train,", "keras"):
            from deepmds_keras.lifting.trainer import train_lifting_net

        self._check_parameters()
        if callable(views):
            if shapes is not None or landmark_sd is not None:
                raise InputError(
                    "shapes and landmark_sd must be omitted if views is a function, which returns "
                    "them. Received one of them."
                )
            faces = sampled_faces(views, self.n_landmarks, self.missing, self.noise, self.seed)
        else:
            given = read_faces(views, shapes, landmark_sd, self.n_landmarks)
            faces = given_faces(given, self.missing, self.noise, self.seed)
        self.weights_, self.history_ = train_lifting_net(
            initial_weights(faces.shapes, self.seed),
            faces.block,
            faces.held_out,
            steps=self.steps,
            batch_size=self.batch_size,
            learning_rate=self.learning_rate,
            label={**self.get_params(), "data": fingerprint(*faces.identified_by)},
            checkpoint=checkpoint,
            progress=progress,
        )
        known_sd = faces.held_out.sd[faces.held_out.visible > 0]  # that of others may be anything
        self.default_sd_ = min(DEFAULT_SD, float(known_sd.mean()))
        self.mean_shape_ = faces.shapes.mean(0).T
        return self

    @overload
    def predict(
        self,
        views: np.ndarray,
        *,
        landmark_sd: float | np.ndarray | None = ...,
        visible: np.ndarray | None = ...,
        return_std: Literal[False] = ...,
        check_orientation: bool = ...,
    ) -> np.ndarray: ...

    @overload
    def predict(
        self,
        views: np.ndarray,
        *,
        landmark_sd: float | np.ndarray | None = ...,
        visible: np.ndarray | None = ...,
        return_std: Literal[True],
        check_orientation: bool = ...,
    ) -> tuple[np.ndarray, np.ndarray]: ...

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
                landmark with a coordinate that is NaN or masked is missing.
            landmark_sd: Standard deviation of the errors of a coordinate, in the unit of the
                views: one number, one for each face `(n,)` or for each landmark, `(n, L)` or, of
                one view, `(L,)`. None assumes `default_sd_`, which suits good landmarks; use 0 for
                exact ones.
            visible: `(n, L)` or `(L,)` bool, False where a landmark is missing, whatever `views`
                has there.
            return_std: Whether to return standard deviations too.
            check_orientation: Whether to refuse a batch, in a known landmark scheme, most of which
                is upside down or mirrored. Single faces of odd orientation are estimated.

        Returns:
            `(n, L, 3)`, or `(L, 3)` for one view `(L, 2)`: frontal shapes, missing landmarks
            included, +x to the subject's left, +y up, +z out of the face, in the unit of
            `normalise` for shapes that are centred (the shipped weights: in the frame of their
            face models); true size cannot be seen in one view. The mean of the landmarks is about
            0. With `return_std`, also as many standard deviations of the errors, where the mean of
            the true landmarks is 0.

        Raises:
            InputError: Another number of landmarks, infinity, fewer than six visible landmarks or
                all on one line; `visible` or `landmark_sd` of another shape; wrong orientation.
        """
        seen = prepare_views(views, self.n_landmarks, visible, landmark_sd)
        if check_orientation:
            check_views(seen.points)
        shapes, std, _ = self._estimate(seen, of_one=np.ndim(views) == 2)
        return (shapes, std) if return_std else shapes

    def estimate(
        self,
        views: np.ndarray,
        *,
        landmark_sd: float | np.ndarray | None = None,
        visible: np.ndarray | None = None,
    ) -> Estimate:
        """Shapes, standard deviations and cameras in one pass; orientation is not checked.

        Arguments and errors are those of `predict`.
        """
        seen = prepare_views(views, self.n_landmarks, visible, landmark_sd)
        return self._estimate(seen, of_one=np.ndim(views) == 2)

    @property
    def n_parameters(self) -> int:
        """Number of trained parameters."""
        return sum(array.size for array in self._trained().values())

    def score(self, views: np.ndarray, shapes: np.ndarray) -> float:
        """`metrics.explained_share` of the predicted and the true shapes.

        Orientation is not checked, as in `fit`.
        """
        return explained_share(self.predict(views, check_orientation=False), shapes)

    def save(self, path: str | Path) -> None:
        """Write parameters and weights to one `.npz` file, whole or not at all."""
        arrays = dict(self._trained())
        if self.mean_shape_ is not None:
            arrays[_MEAN_SHAPE] = self.mean_shape_
        described = {
            "parameters": self.get_params(),
            "default_sd": self.default_sd_,
            "history": self.history_,
        }
        write_arrays(path, arrays, described)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read what `save` wrote.

        Raises:
            InputError: Missing or damaged file, or weights of another network.
        """
        arrays, described = read_arrays(path)
        try:
            lifter = cls(**described["parameters"])
            lifter._check_parameters()
            mean_shape = arrays.pop(_MEAN_SHAPE, None)
            check_weights(arrays, lifter.n_landmarks)
            if mean_shape is not None and mean_shape.shape != (lifter.n_landmarks, 3):
                raise ValueError(f"{_MEAN_SHAPE} has shape {mean_shape.shape}")
            lifter.default_sd_ = float(described["default_sd"])
            lifter.history_ = described["history"]
        except (KeyError, TypeError, ValueError) as error:
            message = f"{path} was not written by LandmarkLifter.save(): {error}."
            raise InputError(message) from None
        lifter.weights_ = {name: np.asarray(array, np.float32) for name, array in arrays.items()}
        lifter.mean_shape_ = mean_shape
        return lifter

    @classmethod
    def pretrained(cls, scheme: str) -> Self:
        """The weights that ship for landmarks of a scheme: `"ibug51"`, `"ibug68"` or `"bfm72"`.

        Raises:
            InputError: No weights for that scheme.
        """
        shipped = weights.pretrained_names(_SHIPPED)
        check_choice(scheme, "scheme", [name.removeprefix(_SHIPPED) for name in shipped])
        return cls.load(weights.pretrained_path(_SHIPPED + scheme))

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Parameters of the constructor by name, as scikit-learn's estimators return them."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def set_params(self, **parameters: Any) -> Self:
        """Set parameters of the constructor.

        Raises:
            InputError: There is no such parameter.
        """
        for name, value in parameters.items():
            if name not in self.get_params():
                raise InputError(f"LandmarkLifter has no parameter {name!r}.")
            setattr(self, name, value)
        return self

    def __sklearn_tags__(self):
        from sklearn.utils import Tags, TargetTags

        return Tags(estimator_type=None, target_tags=TargetTags(required=False))

    def _trained(self) -> dict[str, np.ndarray]:
        arrays = check_fitted(self, "weights_", _SETTERS)
        check_still_of(arrays["mean"].shape[1], self.n_landmarks)
        return arrays

    def _estimate(self, seen: Views, *, of_one: bool) -> Estimate:
        arrays = self._trained()
        sd = np.full_like(seen.visible, self.default_sd_) if seen.sd is None else seen.sd
        inputs = (seen.views, seen.visible, sd)
        chunks = [slice(i, i + _CHUNK) for i in range(0, len(sd), _CHUNK)]
        lifted = [lift(np, arrays, *(a[c] for a in inputs)) for c in chunks]
        shapes, log_sd, cameras = zip(*lifted, strict=True)
        camera = Camera(*map(np.concatenate, zip(*cameras, strict=True)))
        shapes, log_sd = (np.concatenate(parts).swapaxes(1, 2) for parts in (shapes, log_sd))
        pose = HeadPose(
            rotation=camera.rotation,
            scale=(camera.scale * seen.radius)[:, 0],
            translation=camera.shift * seen.radius + seen.centre,
            perspective=camera.perspective[:, 0],
        )
        std = UNIT * np.exp(log_sd)
        return Estimate(shapes[0], std[0], pose[0]) if of_one else Estimate(shapes, std, pose)

    def _check_parameters(self):
        check_n_landmarks(self.n_landmarks, LEAST_VISIBLE)
        check_whole(self.steps, "steps")
        check_whole(self.batch_size, "batch_size")
        check_number(self.learning_rate, "learning_rate")
        check_number(self.missing, "missing", zero=True)
        if self.missing >= 1:
            raise InputError(f"missing must be less than 1. Received {self.missing}.")
        check_number(self.noise, "noise", zero=True)
        check_whole(self.seed, "seed", 0)
