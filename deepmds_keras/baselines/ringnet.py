"""RingNet: a face model's coefficients from an image, learnt from landmarks in images alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import keras
import numpy as np
import tensorflow as tf
from sklearn.base import BaseEstimator

from deepmds_keras.baselines.ringnet_losses import (
    LandmarkCamera,
    in_frame,
    landmark_loss,
    total_loss,
)
from deepmds_keras.baselines.ringnet_net import build_ringnet, seed_dropout
from deepmds_keras.checks import check_fitted, check_images, check_points
from deepmds_keras.errors import InputError
from deepmds_keras.networks import count_trainable, forward_images
from deepmds_keras.streams import Stream
from deepmds_keras.training import (
    face_order,
    image_batches,
    restore_network,
    steps_per_call,
    train_by_epoch,
)

_CHECK_IMAGES = 480


class RingNet(BaseEstimator):
    """ResNet-50 that regresses identity and expression coefficients of a face model from an image.

    After Sanyal et al. 2019, "Learning to regress 3D face shape and expression from an image
    without 3D supervision", arXiv:1905.06817. Training sees no 3D shape: only where the landmarks
    are in each image, and which images are of one person. A mini-batch is made of rings: all images
    of a ring but the last are of one person, whose identity codes are to be closer to each other
    than to the last one's.

    The face model is whichever the bases are of, linear in its coefficients: a jaw that opens is
    one of its expressions, not a joint as in FLAME. The network is trained from scratch, where
    theirs saw real photos. Ours are the schedule, warm-up and then cosine decay, and the weights of
    the two squared norms. Those were chosen, with a smaller network, by the 3D error of synthetic
    people left out of training: a blendshape at a weight of one is many s.d. from rest, and where
    the norm of expressions weighs little, they take part in what identity and depth should explain
    and the shapes become worse than the mean face.

    Args:
        landmark_mean: `(L, 3)` landmarks of the mean face, millimetres.
        identity_basis_times_sd: `(K, L, 3)` what one s.d. of each identity component adds to them.
        expression_basis: `(E, L, 3)` what each expression adds to them at weight one.
        image_size: Width and height of the images, at least 32 pixels.
        ring_size: Images in a ring, at least 3.
        rings_per_batch: Rings in a mini-batch.
        learning_rate: Of Adam, after the warm-up.
        epochs: Rounds of `steps_per_epoch` mini-batches.
        steps_per_epoch: Mini-batches in an epoch.
        seed: Of the initial weights, of dropout and of the order of the images.
        landmark_weight: Of the mean absolute error of the landmarks; the image's side is 2.
        ring_weight: Of the ring loss.
        identity_weight: Of the sum of the squared identity coefficients.
        expression_weight: Of the sum of the squared expression coefficients.

    Attributes:
        network_: Trained `keras.Model`.
        history_: By epoch, `train`: the whole loss while the weights change; `inference`: the mean
            absolute error of the landmarks thereafter, over a fixed 480 of the images, in half
            sides of the image.
    """

    def __init__(
        self,
        landmark_mean: np.ndarray,
        identity_basis_times_sd: np.ndarray,
        expression_basis: np.ndarray,
        *,
        image_size: int = 96,
        ring_size: int = 6,
        rings_per_batch: int = 4,
        learning_rate: float = 3e-4,
        epochs: int = 20,
        steps_per_epoch: int = 500,
        seed: int = 0,
        landmark_weight: float = 60.0,
        ring_weight: float = 1.0,
        identity_weight: float = 1e-2,
        expression_weight: float = 1e-1,
    ):
        self.landmark_mean = landmark_mean
        self.identity_basis_times_sd = identity_basis_times_sd
        self.expression_basis = expression_basis
        self.image_size = image_size
        self.ring_size = ring_size
        self.rings_per_batch = rings_per_batch
        self.learning_rate = learning_rate
        self.epochs = epochs
        self.steps_per_epoch = steps_per_epoch
        self.seed = seed
        self.landmark_weight = landmark_weight
        self.ring_weight = ring_weight
        self.identity_weight = identity_weight
        self.expression_weight = expression_weight

    def fit(
        self,
        images,
        landmarks: np.ndarray,
        subjects: np.ndarray,
        *,
        checkpoint: str | Path | None = None,
        progress: Callable[[dict], object] | None = None,
    ) -> RingNet:
        """Train on images with their landmarks, several of each subject.

        Args:
            images: `(n, image_size, image_size, 3)` uint8, an array or what is indexed like one; a
                mini-batch at a time is read.
            landmarks: `(n, L, 2)` pixels, x right and y down from the left upper corner.
            subjects: `(n,)` int, who is in each image.
            checkpoint: File to go on from, and to write after every epoch.
            progress: Called after every epoch with its losses.

        Raises:
            InputError: Unequal numbers, fewer than two subjects or too few images of one to make a
                ring, bases of other landmarks, or a checkpoint of another run.
        """
        landmarks = check_points(landmarks, "landmarks", 2)
        subjects = np.asarray(subjects)
        self._check_training(len(images), landmarks, subjects)
        points = np.float32(in_frame(landmarks, self.image_size))
        fill = float(np.ptp(points, axis=1).max(1).mean() / 2)
        bases = self.identity_basis_times_sd, self.expression_basis
        camera = LandmarkCamera(self.landmark_mean, *bases, fill)
        network = build_ringnet(*map(len, bases), self.image_size, self.seed)
        steps, n_batch = self.steps_per_epoch, self.rings_per_batch * self.ring_size
        weights = {
            name: getattr(self, f"{name}_weight")
            for name in ("landmark", "ring", "identity", "expression")
        }
        network.compile(
            self._optimizer(),
            total_loss(camera, self.ring_size, weights),
            steps_per_execution=steps_per_call(steps),
            jit_compile=False,  # the compiler's own convolutions are the slower ones
        )
        points = points.reshape(len(points), -1)
        members = _members(subjects)

        def batches(epoch: int) -> tf.data.Dataset:
            seed_dropout(network, self.seed, epoch)
            rings = draw_rings(
                members, steps * self.rings_per_batch, self.ring_size, self.seed, epoch
            )
            return image_batches(images, points, rings.reshape(steps, n_batch))

        check = np.arange(min(len(images), _CHECK_IMAGES))

        def inference() -> float:
            found = forward_images(network, images[check])
            return float(landmark_loss(camera, points[check], found))

        label = {"network": network.name, "images": len(images), "subjects": len(members)}
        label |= self._label()
        self.history_ = train_by_epoch(network, batches, label, inference, checkpoint, progress)
        self.network_ = network
        return self

    def restore(self, checkpoint: str | Path) -> RingNet:
        """Take the network that `fit` trained to the end, and train nothing.

        Raises:
            InputError: The file is missing, unfinished, damaged or of another run.
        """
        bases = self.identity_basis_times_sd, self.expression_basis
        self.network_ = build_ringnet(*map(len, bases), self.image_size)
        self.history_ = restore_network(self.network_, checkpoint, self._label())
        return self

    def coefficients(self, images: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Identity and expression coefficients of the faces in images.

        Args:
            images: `(n, image_size, image_size, 3)` uint8.

        Returns:
            `(n, K)` and `(n, E)`.

        Raises:
            InputError: Not trained, or images of another kind or size.
        """
        network = check_fitted(self, "network_", "fit or restore")
        found = forward_images(network, check_images(images, self.image_size))
        n_expression = len(self.expression_basis)
        start = found.shape[1] - n_expression - len(self.identity_basis_times_sd)
        return found[:, start:-n_expression], found[:, -n_expression:]

    def predict(self, images: np.ndarray) -> np.ndarray:
        """Landmarks of the faces in images, in the frame of the face model: the pose is left out.

        Args:
            images: `(n, image_size, image_size, 3)` uint8.

        Returns:
            `(n, L, 3)` millimetres.

        Raises:
            InputError: As `coefficients`.
        """
        identity, expression = self.coefficients(images)
        offsets = np.tensordot(identity, self.identity_basis_times_sd, 1)
        return self.landmark_mean + offsets + np.tensordot(expression, self.expression_basis, 1)

    @property
    def n_parameters(self) -> int:
        """Trainable parameters."""
        return count_trainable(check_fitted(self, "network_", "fit or restore"))

    def _label(self) -> dict:
        """Label of the checkpoint: all that the network depends on beside the data."""
        return {name: value for name, value in self.get_params().items() if not np.ndim(value)}

    def _optimizer(self) -> keras.optimizers.Optimizer:
        """Adam, whose rate grows over a twentieth of the steps and then falls by a cosine."""
        steps = self.epochs * self.steps_per_epoch
        warm_up = max(steps // 20, 1)
        schedule = keras.optimizers.schedules.CosineDecay(
            self.learning_rate / warm_up,
            max(steps - warm_up, 1),
            warmup_target=self.learning_rate,
            warmup_steps=warm_up,
        )
        return keras.optimizers.Adam(schedule)

    def _check_training(self, n: int, landmarks: np.ndarray, subjects: np.ndarray) -> None:
        n_landmarks = len(self.landmark_mean)
        if landmarks.shape != (n, n_landmarks, 2):
            raise InputError(
                f"landmarks must have shape ({n}, {n_landmarks}, 2), a row for each image. "
                f"Received {landmarks.shape}."
            )
        if subjects.shape != (n,):
            raise InputError(
                f"subjects must have shape ({n},), a number for each image. "
                f"Received {subjects.shape}."
            )
        for name in ("identity_basis_times_sd", "expression_basis"):
            shape = np.shape(getattr(self, name))
            if len(shape) != 3 or not shape[0] or shape[1:] != (n_landmarks, 3):
                raise InputError(
                    f"{name} must have shape (components >= 1, {n_landmarks}, 3). Received {shape}."
                )
        if self.ring_size < 3:
            raise InputError(f"ring_size must be at least 3. Received {self.ring_size}.")
        counts = np.unique(subjects, return_counts=True)[1]
        if len(counts) < 2 or counts.min() < self.ring_size - 1:
            raise InputError(
                f"subjects must be two or more with {self.ring_size - 1} images each or more. "
                f"Received {len(counts)}, one with {counts.min()}."
            )


def draw_rings(
    members: list[np.ndarray], n_rings: int, ring_size: int, seed: int, epoch: int
) -> np.ndarray:
    """Rings of an epoch: every subject as often as another, and one image of somebody else last.

    Args:
        members: Row numbers of each subject's images.
        n_rings: Rings in the epoch.
        ring_size: Images in a ring.
        seed: Of the training.
        epoch: Number of the epoch.

    Returns:
        `(n_rings, ring_size)` row numbers.
    """
    rng = np.random.default_rng([seed, Stream.RINGS, epoch])
    whose = face_order(len(members), n_rings, seed, epoch)
    others = (whose + rng.integers(1, len(members), n_rings)) % len(members)
    rings = np.empty((n_rings, ring_size), int)
    for ring, subject, other in zip(rings, whose, others, strict=True):
        ring[:-1] = rng.permutation(members[subject])[: ring_size - 1]
        ring[-1] = rng.choice(members[other])
    return rings


def _members(subjects: np.ndarray) -> list[np.ndarray]:
    """Row numbers of each subject's images."""
    order = np.argsort(subjects, kind="stable")
    starts = np.flatnonzero(np.diff(subjects[order])) + 1
    return np.split(order, starts)
