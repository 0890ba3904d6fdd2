"""The method of the paper as one estimator: views of a face in, its 3D landmarks out."""

from collections.abc import Callable
from dataclasses import KW_ONLY, asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Self

import keras
import numpy as np
from sklearn.base import BaseEstimator

from deepmds_keras import networks, weights
from deepmds_keras.embedding import SOLVERS, embed
from deepmds_keras.errors import InputError, check_choice, check_fork
from deepmds_keras.files import read_arrays, write_arrays
from deepmds_keras.geometry.orientation import front_landmark, resolve_orientation
from deepmds_keras.geometry.units import centre, normalise
from deepmds_keras.landmarks import load_scheme, scheme_of
from deepmds_keras.landmarks.y_axis import check_views
from deepmds_keras.metrics import explained_share
from deepmds_keras.proximities import VARIANTS, proximities
from deepmds_keras.training import (
    SCHEDULES,
    Recipe,
    restore_network,
    train_autoencoder,
    train_dissimilarity_net,
)
from deepmds_keras.validation import (
    check_faces,
    check_fitted,
    check_n_jobs,
    check_n_landmarks,
    check_still_of,
    check_views_and_shapes,
    check_whole,
    of_one_or_many,
)

_NETWORKS = ("autoencoder", "dissimilarity_net")
_FACES_PER_CHUNK = 64
_FACES_PER_EMBEDDING = 1024  # whose matrices are in memory at once


@dataclass(eq=False, repr=False)
class DeepMDS(BaseEstimator):
    """3D landmarks of a face from the 2D landmarks of one image (Kamyab and Azimifar).

    view → autoencoder → frontal view → dissimilarity net on all pairs → non-metric MDS → shape.

    Args:
        n_landmarks: L.
        variant: `"paper"` or `"released"`, see `pair_features`.
        centre_views: Whether each view is centred before it is normalised, so that a face may lie
            anywhere in its image. The authors' code does not: then views must come in the
            coordinates of the face model.
        schedule: Learning rate, `"constant"` as in the paper or `"cosine"`. With a constant rate,
            the running statistics of batch normalisation lag behind the weights, and the error in
            use is far above that in training.
        autoencoder_epochs: Epochs, in mini-batches of 16 faces.
        dissimilarity_epochs: Epochs of `dissimilarity_steps` mini-batches, each of one face.
        dissimilarity_steps: Mini-batches per epoch.
        seed: Seed of the initial weights and of the order of the faces.
        solver: Solver of the embedding, as for `embed`.
        n_jobs: Number of processes for the embedding; -1 uses every core.

    Attributes:
        autoencoder_: Trained `keras.Model`.
        dissimilarity_net_: Trained `keras.Model`.
        front_landmark_: 0-based number of the landmark farthest in front; it decides which of the
            two mirror images of an embedding is the face.
        history_: Losses by network and epoch.

    Shipped weights take landmarks in the order of a scheme (docs/landmarks.md).

    Examples:
        >>> from deepmds_keras import DeepMDS, LandmarkLifter
        >>> face = LandmarkLifter.pretrained("ibug51").mean_shape_  # (51, 3)
        >>> shape = DeepMDS.pretrained("deepmds-ibug51").predict(face[:, :2])  # y up
        >>> shape.shape
        (51, 3)
    """

    n_landmarks: int = 72
    variant: str = "paper"
    _: KW_ONLY
    centre_views: bool = False
    schedule: str = "constant"
    autoencoder_epochs: int = 30
    dissimilarity_epochs: int = 30
    dissimilarity_steps: int = 1000
    seed: int = 0
    solver: str = "sklearn"
    n_jobs: int | None = None

    def fit(
        self,
        views: np.ndarray,
        shapes: np.ndarray,
        *,
        checkpoint: str | Path | None = None,
        progress: Callable[[str, dict], object] | None = None,
    ) -> Self:
        """Train both networks, the second on the first one's predictions for the training views.

        Args:
            views: `(n, L, 2)` landmarks in the image, y up, any scale; for the origin see
                `centre_views`.
            shapes: `(n, L, 3)` true landmarks, +z out of the face, any scale.
            checkpoint: Folder to which each network is written after every epoch, see
                `checkpoint_files`. An interrupted fit resumes from there, and a network that
                another fit has trained on the same data in the same way is only read.
            progress: Called after every epoch with the network's name and its losses.

        Raises:
            InputError: A parameter out of range, wrong number of landmarks, unequal numbers of
                faces, NaN or infinity, or a checkpoint of other data or parameters.
        """
        self._check_parameters()
        views, shapes = check_views_and_shapes(views, shapes)
        views, shapes = self._normalised(views), normalise(shapes)
        history = {}
        # By the views, a dissimilarity net is known to be of the same fit as an autoencoder.
        seen = weights.fingerprint(views.astype(np.float32))
        also = {"centre_views": self.centre_views, "views": seen}
        autoencoder, history["autoencoder"] = train_autoencoder(
            views,
            shapes[..., :2],
            self._recipe("autoencoder"),
            **self._training("autoencoder", checkpoint, progress, also),
        )
        dissimilarity_net, history["dissimilarity_net"] = train_dissimilarity_net(
            self._frontal(autoencoder, views),
            shapes,
            self._recipe("dissimilarity_net"),
            variant=self.variant,
            **self._training("dissimilarity_net", checkpoint, progress, also),
        )
        # All at once: a fit that is stopped leaves the model as it was.
        self.autoencoder_, self.dissimilarity_net_ = autoencoder, dissimilarity_net
        self.front_landmark_, self.history_ = front_landmark(shapes), history
        return self

    def restore(self, checkpoint: str | Path, shapes: np.ndarray) -> Self:
        """Load the networks that a finished `fit` wrote to a folder, and train nothing.

        Args:
            shapes: `(n, L, 3)` shapes of their training.

        Raises:
            InputError: A network is missing, unfinished, damaged or of another run, or shapes as
                for `fit`.
        """
        built, history, views = self._build(), {}, None
        for network, (name, file) in zip(built, self._files(checkpoint).items(), strict=True):
            label = {"seed": self.seed, "centre_views": self.centre_views, "views": views}
            described = restore_network(network, file, label | asdict(self._recipe(name)))
            history[name], views = described["history"], described["label"].get("views")
        shapes = normalise(check_faces(shapes, "shapes", 3, self.n_landmarks))
        self.autoencoder_, self.dissimilarity_net_ = built
        self.front_landmark_, self.history_ = front_landmark(shapes), history
        return self

    def predict(
        self,
        views: np.ndarray,
        *,
        check_orientation: bool = True,
        progress: Callable[[int], object] | None = None,
    ) -> np.ndarray:
        """3D landmarks of each view.

        Distances determine neither rotation nor translation nor handedness. The embedding is
        rotated onto the frontal view of the autoencoder. Of the two mirror images that remain, the
        one with `front_landmark_` (the tip of the nose) in front is taken.

        Args:
            views: `(n, L, 2)` or `(L, 2)`, as for `fit`.
            check_orientation: Whether to refuse views of a known landmark scheme that are upside
                down or mirrored.
            progress: Called with the number of faces just embedded.

        Returns:
            `(n, L, 3)` frontal shapes, or `(L, 3)` of a single view: +x to the subject's left, +y
            up, +z out of the face, in the unit of `normalise`; true size cannot be seen in one
            view. x and y lie over `frontalise(views)`, the mean of z is 0.

        Raises:
            InputError: Not trained, or with another variant or number of landmarks; NaN, infinity,
                degenerate landmarks, wrong orientation, or a parameter out of range.
        """
        self._check_parameters()
        if check_orientation:
            check_views(check_faces(views, "views", 2, self.n_landmarks))
        frontal = self.frontalise(views)
        shapes = np.empty((*frontal.shape[:2], 3))
        for start in range(0, len(frontal), _FACES_PER_EMBEDDING):
            faces = slice(start, start + _FACES_PER_EMBEDDING)
            shapes[faces] = embed(
                np.abs(self._matrices(frontal[faces])),  # as the released code does before mdscale
                solver=self.solver,
                n_jobs=self.n_jobs,
                progress=progress,
            )
        shapes = resolve_orientation(shapes, frontal, self.front_landmark_)
        return of_one_or_many(shapes, views)

    def score(self, views: np.ndarray, shapes: np.ndarray) -> float:
        """`metrics.explained_share` of the predicted and the true shapes, orientation unchecked."""
        return explained_share(self.predict(views, check_orientation=False), shapes)

    def frontalise(self, views: np.ndarray) -> np.ndarray:
        """`(n, L, 2)` x and y of the shape from the autoencoder; errors as for `predict`."""
        return self._frontal(self._trained("autoencoder_"), views)

    def dissimilarities(self, views: np.ndarray) -> np.ndarray:
        """3D distances of all pairs, as the net estimates them: `(n, L, L)`; errors as `predict`.

        The diagonal is not exactly 0 and near neighbours may be slightly negative; `embed` ignores
        the former and drops the sign of the latter.
        """
        return self._matrices(self.frontalise(views))

    def save(self, path: str | Path) -> None:
        """Write parameters and both networks to an `.npz`.

        Raises:
            InputError: Not trained, or with another variant or number of landmarks.
            OSError: As for `atomic_write`.
        """
        arrays: dict[str, np.ndarray] = {}
        for name in _NETWORKS:
            held = weights.network_arrays(self._trained(f"{name}_"))
            arrays |= {f"{name}/{key}": array for key, array in held.items()}
        rest = {"front_landmark": int(self.front_landmark_), "history": self.history_}
        write_arrays(path, arrays, {"parameters": self.get_params(), **rest})

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read what `save` wrote.

        Raises:
            InputError: Missing or damaged file, weights of another shape, or a fork of a process
                that has used Keras.
        """
        check_fork("Keras")
        arrays, described = read_arrays(path)
        try:
            parameters = described["parameters"]
            if parameters.get("solver") == "auto":  # in files of version 0.3
                parameters["solver"] = "sklearn"
            model = cls(**parameters)
            model.front_landmark_ = range(model.n_landmarks)[described["front_landmark"]]
            model.history_ = described["history"]
            if len(arrays["autoencoder/encode_1/kernel"]) != 2 * model.n_landmarks:
                raise ValueError(f"its weights are not of {model.n_landmarks} landmarks")
            model.autoencoder_, model.dissimilarity_net_ = model._build()
        except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
            raise InputError(f"{path} was not written by DeepMDS.save(): {error}.") from None
        for name in _NETWORKS:
            prefix = f"{name}/"
            held = {k.removeprefix(prefix): a for k, a in arrays.items() if k.startswith(prefix)}
            weights.set_network_arrays(getattr(model, f"{name}_"), held, str(path))
        return model

    @classmethod
    def pretrained(cls, name: str) -> Self:
        """Shipped weights `"deepmds-ibug51"` or `"deepmds-bfm72"`; other names: InputError."""
        check_choice(name, "name", weights.pretrained_names("deepmds-"))
        return cls.load(weights.pretrained_path(name))

    @classmethod
    def from_released(
        cls, autoencoder_h5: str | Path, dissimilarity_h5: str | Path, *, n_landmarks: int = 72
    ) -> Self:
        """The `"released"` variant with the authors' Keras 2 weight files.

        Raises:
            InputError: Missing or truncated file, weights of another network or not finite, or a
                number of landmarks that no scheme has.
        """
        model = cls(n_landmarks, "released")
        model.history_ = {}
        # These weights come without the shapes of their training.
        model.front_landmark_ = load_scheme(scheme_of(n_landmarks)).index("nose_tip")
        model.autoencoder_, model.dissimilarity_net_ = model._build()
        weights.read_keras2_weights(model.autoencoder_, autoencoder_h5)
        weights.read_keras2_weights(model.dissimilarity_net_, dissimilarity_h5)
        return model

    @property
    def n_parameters(self) -> int:
        """Trainable parameters of both networks."""
        return networks.count_trainable(*(self._trained(f"{name}_") for name in _NETWORKS))

    def _normalised(self, views: np.ndarray) -> np.ndarray:
        views = check_faces(views, "views", 2, self.n_landmarks)
        return normalise(centre(views) if self.centre_views else views)

    def _frontal(self, autoencoder: keras.Model, views: np.ndarray) -> np.ndarray:
        views = self._normalised(views)
        flat = views.reshape(len(views), -1).astype(np.float32)
        return networks.forward(autoencoder, flat).reshape(views.shape)

    def _matrices(self, frontal: np.ndarray) -> np.ndarray:
        network = self._trained("dissimilarity_net_")
        points = normalise(frontal).astype(np.float32)
        first, second = np.triu_indices(self.n_landmarks)
        matrices = np.empty((len(points), self.n_landmarks, self.n_landmarks), np.float32)
        for start in range(0, len(points), _FACES_PER_CHUNK):
            faces = slice(start, start + _FACES_PER_CHUNK)
            features = proximities(points[faces, first], points[faces, second], self.variant)
            distances = networks.forward(network, features.reshape(-1, features.shape[-1]))
            distances = distances.reshape(features.shape[:2])
            matrices[faces, first, second] = matrices[faces, second, first] = distances
        return matrices

    def _recipe(self, network: str) -> Recipe:
        if network == "autoencoder":
            return Recipe(self.autoencoder_epochs, schedule=self.schedule)
        return Recipe(self.dissimilarity_epochs, self.dissimilarity_steps, self.schedule)

    def _training(
        self, network: str, checkpoint: str | Path | None, progress: Callable | None, also: dict
    ) -> dict[str, Any]:
        """Options of a network's training besides its recipe."""
        file = None if checkpoint is None else self._files(checkpoint)[network]
        report = None if progress is None else partial(progress, network)
        return {"seed": self.seed, "checkpoint": file, "progress": report, "also": also}

    def _check_parameters(self) -> None:
        check_n_landmarks(self.n_landmarks)
        check_choice(self.variant, "variant", VARIANTS)
        check_choice(self.schedule, "schedule", SCHEDULES)
        check_choice(self.solver, "solver", SOLVERS)
        for name in ("autoencoder_epochs", "dissimilarity_epochs", "dissimilarity_steps"):
            check_whole(getattr(self, name), name)
        check_whole(self.seed, "seed", 0)
        check_n_jobs(self.n_jobs)

    def _files(self, checkpoint: str | Path) -> dict[str, Path]:
        return weights.checkpoint_files(checkpoint, self.variant, self.schedule)

    def _build(self) -> tuple[keras.Model, keras.Model]:
        """Autoencoder and dissimilarity net, untrained."""
        autoencoder = networks.build_autoencoder(self.n_landmarks)
        return autoencoder, networks.build_dissimilarity_net(self.variant)

    def _trained(self, name: str) -> keras.Model:
        network = check_fitted(self, name, "fit, restore, load or pretrained")
        n_inputs = network.input_shape[1]
        if name == "autoencoder_":
            check_still_of(n_inputs // 2, self.n_landmarks)
        else:
            variant = next(v for v, n_features in VARIANTS.items() if n_features == n_inputs)
            check_still_of(variant, self.variant, "variant")
        return network
