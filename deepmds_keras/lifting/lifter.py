"""The lifting network as one estimator: views of a face in, its 3D landmarks out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from sklearn.base import BaseEstimator

from deepmds_keras import weights
from deepmds_keras.checks import check_fitted
from deepmds_keras.errors import InputError, needs
from deepmds_keras.lifting.faces import GivenFaces, SampledFaces, read_faces
from deepmds_keras.lifting.network import SIZES, initial_weights
from deepmds_keras.lifting.trained import SETTERS, TrainedLifter, not_a_lifter, read_lifter
from deepmds_keras.lifting.views import LEAST_VISIBLE
from deepmds_keras.metrics import explained_share


class LandmarkLifter(TrainedLifter, BaseEstimator):
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

    Landmarks are in the order of a scheme, `load_scheme("ibug51").names` (docs/landmarks.md).
    Weights that ship: `"lifting-ibug51"`, `"lifting-ibug68"` and `"lifting-bfm72"`.

    Examples:
        >>> import numpy as np
        >>> from deepmds_keras import LandmarkLifter
        >>> lifter = LandmarkLifter.pretrained("lifting-ibug51")
        >>> face = lifter.weights_["mean"].T  # (51, 3): the mean face
        >>> shapes, sd = lifter.predict(face[:, :2], return_std=True)  # y up
        >>> shapes.shape, sd.shape
        ((1, 51, 3), (1, 51, 3))
        >>> rng = np.random.default_rng(0)
        >>> shapes = rng.normal(size=(51, 3)) + 0.1 * rng.normal(size=(200, 51, 3))
        >>> views = shapes[..., :2]  # y up
        >>> lifter = LandmarkLifter(51, steps=100).fit(views, shapes)
        >>> lifted, sd = lifter.predict(views, return_std=True, check_orientation=False)
        >>> lifted.shape, sd.shape
        ((200, 51, 3), (200, 51, 3))
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
        with needs("Keras with TensorFlow, which train,", "keras"):
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

    def score(self, views: np.ndarray, shapes: np.ndarray) -> float:
        """How good predictions are, as `metrics.explained_share` of them and true shapes."""
        return explained_share(self.predict(views), shapes)

    def save(self, path: str | Path) -> None:
        """Write parameters and weights into one `.npz` file, complete or not at all."""
        arrays = check_fitted(self, "weights_", SETTERS)
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
        arrays, described = read_lifter(path)
        try:
            lifter = cls(**described["parameters"])
            lifter._check_parameters()
        except TypeError as error:
            raise not_a_lifter(path, error) from None
        lifter.weights_, lifter.history_ = arrays, described["history"]
        lifter.training_sd_ = float(described["training_sd"])
        return lifter

    @classmethod
    def pretrained(cls, name: str) -> LandmarkLifter:
        """The weights that ship with the package.

        Raises:
            InputError: No weights of that name.
        """
        return cls.load(weights.pretrained_path(name))

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
