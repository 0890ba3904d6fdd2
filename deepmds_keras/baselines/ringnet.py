"""RingNet: a face model's coefficients from an image, learnt from landmarks in images alone."""

from dataclasses import KW_ONLY, dataclass
from itertools import pairwise
from typing import Self

import keras
import numpy as np
import tensorflow as tf
from keras import layers, ops

from deepmds_keras.baselines.base import NetworkMethod, check_shape, draw_kernels
from deepmds_keras.baselines.images import check_images, forward_images, image_batches
from deepmds_keras.errors import InputError, check_fork
from deepmds_keras.streams import Stream
from deepmds_keras.training import face_order
from deepmds_keras.validation import check_basis, check_points

_N_POSE = 6  # parameters before the coefficients: log scale, x, y, axis-angle
_MARGIN = 0.5  # by which the squared distance of another person's code must be larger
_MIN_IMAGE_SIZE = 32  # ResNet-50 halves an image five times
_CHECK_IMAGES = 480


@dataclass(eq=False, repr=False)
class RingNet(NetworkMethod):
    """ResNet-50 that regresses identity and expression coefficients of a face model from an image.

    After Sanyal et al. 2019, "Learning to regress 3D face shape and expression from an image
    without 3D supervision", arXiv:1905.06817. Training sees no 3D shape: only where the landmarks
    are in each image, and which images are of one person. A mini-batch consists of rings: all
    images of a ring but the last are of one person, whose identity codes are to be closer to each
    other than to the last one's.

    The face model is given by the bases and is linear in its coefficients: an open jaw is one of
    its expressions, not a joint as in FLAME. The network is trained from scratch, whereas theirs
    saw real photos. Ours are the schedule, warm-up and then cosine decay, and the weights of the
    two squared norms. Those were chosen, with a smaller network, by the 3D error on synthetic
    people left out of training: a blendshape at a weight of one is many s.d. from rest. With a low
    weight on the norm of expressions, these explain part of what identity and depth should, and the
    shapes become worse than the mean face.

    Args:
        landmark_mean: `(L, 3)` landmarks of the mean face, millimetres.
        identity_basis_times_sd: `(K, L, 3)` their offsets at one s.d. of each identity component.
        expression_basis: `(E, L, 3)` their offsets at weight one of each expression.
        image_size: Width and height of the images, at least 32 pixels.
        ring_size, rings_per_batch: Images in a ring, at least 3, and rings in a mini-batch.
        learning_rate: Adam's learning rate after the warm-up.
        seed: Seed of the initial weights, of dropout and of the order of the images.
        landmark_weight: Weight of the landmarks' mean absolute error; the image's side is 2.
        ring_weight: Weight of the ring loss.
        identity_weight, expression_weight: Weights of the sums of the squared coefficients.

    Attributes:
        history_: `train` is the whole loss; `inference` the mean absolute error of the landmarks
            over a fixed choice of 480 images, in half sides of the image.
    """

    landmark_mean: np.ndarray
    identity_basis_times_sd: np.ndarray
    expression_basis: np.ndarray
    _: KW_ONLY
    image_size: int = 96
    ring_size: int = 6
    rings_per_batch: int = 4
    learning_rate: float = 3e-4
    epochs: int = 20
    steps_per_epoch: int = 500
    seed: int = 0
    landmark_weight: float = 60.0
    ring_weight: float = 1.0
    identity_weight: float = 1e-2
    expression_weight: float = 1e-1

    def fit(self, images, landmarks: np.ndarray, subjects: np.ndarray, **training) -> Self:
        """Train on images with their landmarks, several of each subject.

        Args:
            images: `(n, image_size, image_size, 3)` uint8, an array or something indexed like one;
                read one mini-batch at a time.
            landmarks: `(n, L, 2)` pixels, x right and y down from the upper left corner.
            subjects: `(n,)` int, the person in each image.

        Raises:
            InputError: Unequal numbers, fewer than two subjects or too few images of one for a
                ring, bases of other landmarks, or a checkpoint of another run.
        """
        self._check_parameters()
        landmarks, subjects = check_points(landmarks, "landmarks", 2), np.asarray(subjects)
        n_landmarks = len(self.landmark_mean)
        check_shape(landmarks, "landmarks", (len(images), n_landmarks, 2))
        check_shape(subjects, "subjects", (len(images),))
        for name in ("identity_basis_times_sd", "expression_basis"):
            check_basis(getattr(self, name), name, n_landmarks)
        if self.ring_size < 3:
            raise InputError(f"ring_size must be at least 3. Received {self.ring_size}.")
        members = [np.flatnonzero(subjects == subject) for subject in np.unique(subjects)]
        least = min(map(len, members))
        if len(members) < 2 or least < self.ring_size - 1:
            raise InputError(
                f"subjects must be two or more with {self.ring_size - 1} images each or more. "
                f"Received {len(members)}, one with {least}."
            )
        # From -1 to 1, y up.
        points = np.asarray((2 * landmarks / self.image_size - 1) * [1, -1], np.float32)
        fill = float(np.ptp(points, axis=1).max(1).mean() / 2)
        points = points.reshape(len(points), -1)
        loss, check = RingNetLoss(self, fill), np.arange(min(len(images), _CHECK_IMAGES))
        steps, n_rings = self.steps_per_epoch, self.steps_per_epoch * self.rings_per_batch
        # Not compiled by XLA, whose convolutions are slower.
        network = self._compiled(self._optimizer(), loss, jit_compile=False)
        dropouts = network.get_layer("regressor").dropouts

        def mini_batches(epoch: int) -> dict:
            for number, layer in enumerate(dropouts):  # as in an unbroken training
                layer.seed_generator.state.assign([1000 * self.seed + number, epoch])
            rings = draw_rings(members, n_rings, self.ring_size, self.seed, epoch)
            return {"x": image_batches(images, points, rings.reshape(steps, -1))}

        def inference() -> float:
            return float(loss.landmark_loss(points[check], forward_images(network, images[check])))

        data = images, points, subjects
        return self._train(network, mini_batches, data, inference, **training)

    def predict(self, images: np.ndarray) -> np.ndarray:
        """Landmarks of the faces in images, in the frame of the face model, without the pose.

        Images `(n, image_size, image_size, 3)` uint8 give `(n, L, 3)` millimetres.

        Raises:
            InputError: Not trained, or images of another kind or size.
        """
        network = self._trained()
        parameters = forward_images(network, check_images(images, network.input_shape[1]))
        end = _N_POSE + len(self.identity_basis_times_sd)
        identity = np.tensordot(parameters[:, _N_POSE:end], self.identity_basis_times_sd, 1)
        expression = np.tensordot(parameters[:, end:], self.expression_basis, 1)
        return self.landmark_mean + identity + expression

    def _build(self, seed: int = 0) -> keras.Model:
        n_coefficients = len(self.identity_basis_times_sd), len(self.expression_basis)
        return build_ringnet(*n_coefficients, self.image_size, seed)

    def _optimizer(self) -> keras.optimizers.Optimizer:
        """Adam, with a rate that rises over a twentieth of the steps and then falls as a cosine."""
        steps, rate = self.epochs * self.steps_per_epoch, self.learning_rate
        warm_up = max(steps // 20, 1)
        warming = {"warmup_target": rate, "warmup_steps": warm_up}
        decay = keras.optimizers.schedules.CosineDecay
        return keras.optimizers.Adam(decay(rate / warm_up, max(steps - warm_up, 1), **warming))


def build_ringnet(
    n_identity: int, n_expression: int, image_size: int = 96, seed: int = 0
) -> keras.Model:
    """ResNet-50 with an iterative regressor of the camera, pose and coefficients of a face.

    After Sanyal et al. 2019, arXiv:1905.06817. The 2,048 features of ResNet-50 and the current
    estimate of the parameters go through two layers of 512 ReLU units with dropout and a linear
    one, whose output is added to the estimate. Three iterations share these layers, as in Kanazawa
    et al. 2018 (HMR, arXiv:1712.06584), from where the regressor comes.

    Two things are ours. The running averages of batch normalisation forget ten times faster than
    Keras's default; in a few thousand steps those would lag behind the weights. And dropout removes
    a fifth of the units; the sources at hand do not give their rate.

    Args:
        n_identity, n_expression: Numbers of coefficients.
        image_size: Width and height of the images, at least 32 pixels.
        seed: Seed of the initial weights.

    Returns:
        Model from `(n, image_size, image_size, 3)` images in [-1, 1] to the parameters,
        `(n, 6 + n_identity + n_expression)`: log scale, x, y, axis-angle, identity, expression. All
        zeros are the mean face, seen from the front in the middle of the image.

    Raises:
        InputError: Images of less than 32 pixels.
    """
    if image_size < _MIN_IMAGE_SIZE:
        raise InputError(f"image_size must be at least {_MIN_IMAGE_SIZE}. Received {image_size}.")
    check_fork("Keras")
    body = keras.applications.ResNet50(
        input_shape=(image_size, image_size, 3), include_top=False, weights=None, pooling="avg"
    )
    for layer in body.layers:
        if isinstance(layer, layers.BatchNormalization):
            layer.momentum = 0.9
    regressor = Regressor(_N_POSE + n_identity + n_expression, name="regressor")
    name = f"ringnet_{n_identity}_{n_expression}"
    net = keras.Model(body.input, regressor(body.output), name=name)
    draw_kernels(net, seed)
    # So that training starts near the mean face, seen from the front.
    correction = regressor.kernels[-1]
    correction.assign(0.01 * correction)
    return net


@keras.saving.register_keras_serializable("deepmds_keras")
class Regressor(layers.Layer):
    """Three corrections, by the same dense layers, of an estimate that starts at zero.

    Called with `(n, F)` features; returns `(n, n_parameters)`.
    """

    def __init__(self, n_parameters: int, **options):
        super().__init__(**options)
        self.n_parameters = n_parameters
        self.kernels: list[keras.Variable] = []
        self.biases: list[keras.Variable] = []
        self.dropouts = [layers.Dropout(0.2, seed=number) for number in (1, 2)]

    def build(self, shape: tuple) -> None:
        sizes = (shape[-1] + self.n_parameters, 512, 512, self.n_parameters)
        for number, size in enumerate(pairwise(sizes), 1):
            self.kernels.append(self.add_weight(size, name=f"{number}_kernel"))
            self.biases.append(self.add_weight(size[1:], "zeros", name=f"{number}_bias"))

    def get_config(self) -> dict:
        return {**super().get_config(), "n_parameters": self.n_parameters}

    def call(self, features, training: bool | None = None):
        estimate = ops.zeros((ops.shape(features)[0], self.n_parameters))
        weights = map(tf.convert_to_tensor, self.kernels + self.biases)
        for seen, *copies in zip(*map(three_copies, [features, *weights]), strict=True):
            kernels, biases = copies[:3], copies[3:]
            x = ops.concatenate([seen, estimate], axis=1)
            for kernel, bias, dropout in zip(kernels, biases, self.dropouts, strict=False):
                x = dropout(ops.relu(x @ kernel + bias), training=training)
            estimate = estimate + x @ kernels[-1] + biases[-1]
        return estimate


@tf.custom_gradient
def three_copies(x):
    """A tensor for three uses, whose gradients are added in a fixed order.

    TensorFlow's sum of more than two tensors starts with one whose memory is free to be
    overwritten: which one that is depends on the timing of threads, and so does the last bit.
    """

    def add(*gradients):
        return ops.sum(ops.stack(gradients), axis=0)

    return [tf.identity(x) for _ in range(3)], add


def draw_rings(
    members: list[np.ndarray], n_rings: int, ring_size: int, seed: int, epoch: int
) -> np.ndarray:
    """Rings of an epoch: every subject equally often, with an image of someone else last.

    `members` has the row numbers of each subject's images; `(n_rings, ring_size)` are returned.
    """
    rng = np.random.default_rng([seed, Stream.RINGS, epoch])
    whose = face_order(len(members), n_rings, seed, epoch)
    others = (whose + rng.integers(1, len(members), n_rings)) % len(members)
    rings = np.empty((n_rings, ring_size), int)
    for ring, subject, other in zip(rings, whose, others, strict=True):
        ring[:-1] = rng.permutation(members[subject])[: ring_size - 1]
        ring[-1] = rng.choice(members[other])
    return rings


class RingNetLoss:
    """The weighted sum of RingNet's four losses, on a batch of whole rings.

    Called with `(n, 2L)` landmarks in [-1, 1] and `(n, P)` parameters of `build_ringnet`. A face
    rotates about the middle of the mean landmarks, so that rotation hardly shifts it. At log scale
    0, half the larger side of the landmarks' box in the image is `fill`.
    """

    def __init__(self, model: RingNet, fill: float):
        low, high = np.min(model.landmark_mean, axis=0), np.max(model.landmark_mean, axis=0)
        unit = max((high - low)[:2]) / 2 / fill
        self.model, self.n_identity = model, len(model.identity_basis_times_sd)
        bases = np.concatenate([model.identity_basis_times_sd, model.expression_basis]) / unit
        self._mean = np.float32((model.landmark_mean - (low + high) / 2) / unit)
        self._bases = np.float32(bases.reshape(len(bases), -1))

    def __call__(self, landmarks, parameters):
        codes = parameters[:, _N_POSE:]
        identity, expression = codes[:, : self.n_identity], codes[:, self.n_identity :]
        return (
            self.model.landmark_weight * self.landmark_loss(landmarks, parameters)
            + self.model.ring_weight * ring_loss(identity, self.model.ring_size)
            + self.model.identity_weight * ops.mean(ops.sum(ops.square(identity), axis=1))
            + self.model.expression_weight * ops.mean(ops.sum(ops.square(expression), axis=1))
        )

    def landmark_loss(self, landmarks, parameters):
        """Mean absolute error of the landmarks in the image, whose side is 2."""
        projected = self.project(parameters)
        return ops.mean(ops.abs(projected - ops.reshape(landmarks, ops.shape(projected))))

    def project(self, parameters):
        """Scaled orthographic view of the landmarks, `(n, L, 2)`, x right, y up, [-1, 1]."""
        offsets = ops.matmul(parameters[:, _N_POSE:], self._bases)
        shapes = self._mean + ops.reshape(offsets, (-1, *self._mean.shape))
        rotations = rotation_matrices(parameters[:, 3:_N_POSE])
        posed = ops.matmul(shapes, ops.transpose(rotations, (0, 2, 1)))
        return ops.exp(parameters[:, :1, None]) * posed[..., :2] + parameters[:, None, 1:3]


def ring_loss(identity, ring_size: int):
    """Codes of one person must be closer to each other than to another person's.

    After Sanyal et al. 2019, arXiv:1905.06817, whose text was not at hand to check the margin and
    the factor in front: the mean over rings of

        1/R · Σ_jk max(0, |β_j − β_k|² − |β_j − β_R|² + η)

    over all ordered pairs j ≠ k of the R − 1 elements of one person; β_R, the last of each ring in
    the `(rings · R, K)` codes, is another's and η 0.5.
    """
    rings = ops.reshape(identity, (-1, ring_size, identity.shape[-1]))
    same, other = rings[:, :-1], rings[:, -1:]
    first, second, third = three_copies(same)
    apart = ops.sum(ops.square(first[:, :, None] - second[:, None]), axis=-1)
    away = ops.sum(ops.square(third - other), axis=-1)
    excess = ops.relu(apart - away[:, :, None] + _MARGIN)
    different = 1 - np.eye(ring_size - 1, dtype=np.float32)
    return ops.mean(ops.sum(excess * different, axis=(1, 2))) / ring_size


def rotation_matrices(axis_angle):
    """Rodrigues: `(n, 3)` axes of length the angle in radians → `(n, 3, 3)`."""
    angle = ops.sqrt(ops.sum(ops.square(axis_angle), axis=1, keepdims=True) + 1e-12)
    x, y, z = ops.split(axis_angle / angle, 3, axis=1)
    zero = ops.zeros_like(x)
    rows = ops.concatenate([zero, -z, y, z, zero, -x, -y, x, zero], axis=1)
    first, second, third = three_copies(ops.reshape(rows, (-1, 3, 3)))
    turn = angle[:, None]
    return ops.eye(3) + ops.sin(turn) * first + (1 - ops.cos(turn)) * ops.matmul(second, third)
