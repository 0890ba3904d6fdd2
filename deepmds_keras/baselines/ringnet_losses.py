"""Losses of RingNet: landmarks in the image, and who is the same person as whom."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from keras import ops

from deepmds_keras.baselines.ringnet_net import N_CAMERA, N_ROTATION

MARGIN = 0.5  # by which another person's code must be farther away, squared
_TINY = 1e-12


def ring_loss(identity, ring_size: int):
    """Codes of one person must be closer to each other than to another person's.

    After Sanyal et al. 2019, arXiv:1905.06817, whose text was not at hand to check the margin and
    the factor in front: the mean over rings of

        1/R · Σ_jk max(0, |β_j − β_k|² − |β_j − β_R|² + η)

    over all ordered pairs j ≠ k of the R − 1 elements of one person; β_R is another's and η 0.5.

    Args:
        identity: `(rings · R, K)` codes; the last of each ring is the other person's.
        ring_size: R.
    """
    rings = ops.reshape(identity, (-1, ring_size, identity.shape[-1]))
    same, other = rings[:, :-1], rings[:, -1:]
    apart = ops.sum(ops.square(same[:, :, None] - same[:, None]), axis=-1)
    away = ops.sum(ops.square(same - other), axis=-1)
    excess = ops.relu(apart - away[:, :, None] + MARGIN)
    different = 1 - np.eye(ring_size - 1, dtype=np.float32)
    return ops.mean(ops.sum(excess * different, axis=(1, 2))) / ring_size


def rotation_matrices(axis_angle):
    """Rodrigues: `(n, 3)` axes of length the angle in radians → `(n, 3, 3)`."""
    angle = ops.sqrt(ops.sum(ops.square(axis_angle), axis=1, keepdims=True) + _TINY)
    x, y, z = ops.split(axis_angle / angle, 3, axis=1)
    zero = ops.zeros_like(x)
    cross = ops.reshape(
        ops.concatenate([zero, -z, y, z, zero, -x, -y, x, zero], axis=1), (-1, 3, 3)
    )
    sine, cosine = ops.sin(angle)[:, None], ops.cos(angle)[:, None]
    return ops.eye(3) + sine * cross + (1 - cosine) * ops.matmul(cross, cross)


def in_frame(pixels: np.ndarray, image_size: int) -> np.ndarray:
    """Pixels, y down, → the image from -1 to 1, y up; `(…, 2)` both."""
    return (2 * np.asarray(pixels) / image_size - 1) * np.array([1.0, -1.0])


class LandmarkCamera:
    """Where a face of given parameters has its landmarks in the image: a scaled orthographic view.

    The face turns about the middle of the mean landmarks, so that turning it hardly shifts it.

    Args:
        landmark_mean: `(L, 3)` landmarks of the mean face, millimetres.
        identity_basis_times_sd: `(K, L, 3)`, millimetres.
        expression_basis: `(E, L, 3)`, millimetres.
        fill: Half the larger side of the landmarks' box in the image at log scale 0, where the
            image reaches from -1 to 1.
    """

    def __init__(self, landmark_mean, identity_basis_times_sd, expression_basis, fill: float):
        low, high = np.min(landmark_mean, axis=0), np.max(landmark_mean, axis=0)
        unit = max((high - low)[:2]) / 2 / fill
        self.n_identity = len(identity_basis_times_sd)
        bases = np.concatenate([identity_basis_times_sd, expression_basis]) / unit
        self._mean = np.float32((landmark_mean - (low + high) / 2) / unit)
        self._bases = np.float32(bases.reshape(len(bases), -1))

    def project(self, parameters):
        """`(n, P)` parameters of `build_ringnet` → `(n, L, 2)`, x right, y up, [-1, 1]."""
        n_pose = N_CAMERA + N_ROTATION
        offsets = ops.matmul(parameters[:, n_pose:], self._bases)
        shapes = self._mean + ops.reshape(offsets, (-1, *self._mean.shape))
        rotations = rotation_matrices(parameters[:, N_CAMERA:n_pose])
        posed = ops.matmul(shapes, ops.transpose(rotations, (0, 2, 1)))
        return ops.exp(parameters[:, :1, None]) * posed[..., :2] + parameters[:, None, 1:N_CAMERA]

    def codes(self, parameters):
        """Identity and expression coefficients among the parameters, `(n, K)` and `(n, E)`."""
        start = N_CAMERA + N_ROTATION
        end = start + self.n_identity
        return parameters[:, start:end], parameters[:, end:]


def total_loss(camera: LandmarkCamera, ring_size: int, weights: dict[str, float]) -> Callable:
    """The weighted sum of RingNet's four losses, on a batch of whole rings.

    Args:
        camera: Projects the landmarks.
        ring_size: Images in a ring.
        weights: Of `landmark` (mean absolute error of the coordinates in the image), `ring`,
            `identity` and `expression` (sum of squared coefficients).

    Returns:
        Function of `(n, 2L)` landmarks in [-1, 1] and `(n, P)` parameters.
    """

    def loss(landmarks, parameters):
        identity, expression = camera.codes(parameters)
        return (
            weights["landmark"] * landmark_loss(camera, landmarks, parameters)
            + weights["ring"] * ring_loss(identity, ring_size)
            + weights["identity"] * ops.mean(ops.sum(ops.square(identity), axis=1))
            + weights["expression"] * ops.mean(ops.sum(ops.square(expression), axis=1))
        )

    return loss


def landmark_loss(camera: LandmarkCamera, landmarks, parameters):
    """Mean absolute error of the landmarks in the image, whose side is 2."""
    projected = camera.project(parameters)
    return ops.mean(ops.abs(projected - ops.reshape(landmarks, ops.shape(projected))))
