"""Camera and posterior step of the lifting network, written once for NumPy and for Keras.

Every function takes `xp`, NumPy or `keras.ops`, first. Arrays are float32 batches with the
landmarks last: views `(n, 2, L)`, shapes `(n, 3, L)`, coefficients of the basis `(n, r)`.
"""

from typing import Any, NamedTuple

import numpy as np

# Precision of the prior on rotation (3), log scale, perspective and shift (2). That of the
# perspective pulls it to 0; the others only fix what the landmarks leave open.
_CAMERA_PRECISION = np.array([1, 1, 1, 1, 4, 1, 1], np.float32)
_PERSPECTIVE = 4
_MOST_PERSPECTIVE = 1.0
_LEAST_DISTANCE = 0.4  # of a landmark from a perspective camera, relative to the face's
_LONGEST_STEP = 0.5  # of the log scale
_RIDGE = 1e-4
_TINY = 1e-12


class Camera(NamedTuple):
    """Projects `S`, with `P = rotation S`, to `scale P_xy / (1 - perspective P_z) + shift`."""

    rotation: Any  # (n, 3, 3)
    scale: Any  # (n, 1)
    perspective: Any  # (n, 1), 0 for an orthographic camera
    shift: Any  # (n, 2)


class Sight(NamedTuple):
    """A projected shape and its derivatives, all in standard deviations of the noise."""

    posed: Any  # (n, 3, L): the rotated shape
    near: Any  # (n, 1, L): inverse distance from the camera
    certainty: Any  # (n, 1, L): inverse standard deviation, 0 for missing landmarks
    seen: Any  # (n, 2, L): the image
    residual: Any  # (n, 2 L): view less image
    along: Any  # (n, 1, L): derivative by motion in the image plane
    across: Any  # (n, 2, L): derivative by motion towards the viewer


def starting_camera(xp, views, visible, mean) -> Camera:
    """The scaled orthographic camera nearest to the best affine one for the mean shape."""
    homogeneous = xp.concatenate([mean, xp.ones_like(mean[:1])], 0)
    weighted = visible[:, None] * homogeneous
    scatter = weighted @ xp.transpose(homogeneous) + _RIDGE * np.eye(4, dtype=np.float32)
    affine = views @ xp.transpose(weighted, (0, 2, 1)) @ xp.linalg.inv(scatter)
    a, b = affine[:, 0, :3], affine[:, 1, :3]
    aa, bb, ab = _dot(a, a), _dot(b, b), _dot(a, b)
    # The inverse square root of a symmetric 2 x 2 matrix has a closed form.
    root = xp.sqrt(xp.maximum(aa * bb - ab * ab, _TINY))
    a, b = (bb + root) * a - ab * b, (aa + root) * b - ab * a
    a, b = (x / xp.sqrt(_dot(x, x) + _TINY) for x in (a, b))
    rotation = xp.stack([a, b, xp.cross(a, b)], 1)
    scale = xp.sqrt(aa + bb + 2 * root) / 2
    return Camera(rotation, scale, 0 * scale, affine[:, :, 3])


def look(xp, camera: Camera, shapes, views, visible, variance) -> Sight:
    """Project a shape; `variance` `(n, L)` is that of the noise of a coordinate."""
    posed = camera.rotation @ shapes
    perspective = camera.perspective[:, :, None]
    near = 1 / xp.maximum(1 - perspective * posed[:, 2:], _LEAST_DISTANCE)
    certainty = (visible / xp.sqrt(variance))[:, None]
    along = camera.scale[:, :, None] * near * certainty
    seen = along * posed[:, :2]
    residual = (views - camera.shift[:, :, None]) * certainty - seen
    across = perspective * near * seen
    return Sight(posed, near, certainty, seen, _flat(xp, residual), along, across)


def project(xp, camera: Camera, sight: Sight, offsets):
    """Project offsets of the landmarks: `(n, 3 L)` → `(n, 2 L)`."""
    moved = camera.rotation @ xp.reshape(offsets, (-1, *sight.posed.shape[1:]))
    return _flat(xp, sight.along * moved[:, :2] + sight.across * moved[:, 2:])


def back_project(xp, camera: Camera, sight: Sight, shifts):
    """Apply the transpose of `project`: `(n, 2 L)` → `(n, 3 L)`."""
    shifts = xp.reshape(shifts, (-1, *sight.across.shape[1:]))
    depth = sight.across[:, :1] * shifts[:, :1] + sight.across[:, 1:] * shifts[:, 1:]
    moved = xp.concatenate([sight.along * shifts, depth], 1)
    return _flat(xp, xp.transpose(camera.rotation, (0, 2, 1)) @ moved)


def posterior_step(xp, camera: Camera, sight: Sight, basis, code, n_iterations: int):
    """Step to the code and camera of highest posterior, with the image linearised in both.

    The code is standard normal. The seven parameters of the camera are eliminated exactly; the
    code is solved for by conjugate gradients, which first fit what the view determines best.

    Args:
        basis: `(r, 3 L)` offsets of the landmarks for a coefficient of 1.
        code: `(n, r)` coefficients of the projected shape.
        n_iterations: Number of conjugate gradient iterations.

    Returns:
        The new code and camera.
    """
    rows = _camera_rows(xp, sight)
    jacobian = rows[:, :-1]
    normal = jacobian @ xp.transpose(rows, (0, 2, 1))
    covariance = xp.linalg.inv(normal[:, :, :-1] + np.diag(_CAMERA_PRECISION))
    prior = _CAMERA_PRECISION[_PERSPECTIVE] * camera.perspective * covariance[:, _PERSPECTIVE]
    transposed = xp.transpose(basis)

    def to_code(shifts, change):
        """Gradient for the code of the shifts that a change of the camera leaves."""
        left = shifts - (change[:, None] @ jacobian)[:, 0]
        return back_project(xp, camera, sight, left) @ transposed

    change = (covariance @ normal[:, :, -1:])[:, :, 0] - prior
    left = to_code(sight.residual, change) - code
    direction, size = left, _dot(left, left)
    step, earlier = 0 * left, []
    for last in [False] * (n_iterations - 1) + [True]:
        shifts = project(xp, camera, sight, direction @ basis)
        matched = (covariance @ (jacobian @ shifts[:, :, None]))[:, :, 0]
        image = to_code(shifts, matched) + direction
        length = size / (_dot(direction, image) + _TINY)
        step = step + length * direction
        change = change - length * matched
        if not last:
            # Residuals are orthogonal to earlier ones; in float32 they do not stay so by
            # themselves, and the code would depend on the order of sums.
            earlier.append(left / xp.sqrt(size + _TINY))
            known = xp.stack(earlier, 1)
            left = left - length * image
            left = left - (left[:, None] @ xp.transpose(known, (0, 2, 1)) @ known)[:, 0]
            size, before = _dot(left, left), size
            direction = left + size / (before + _TINY) * direction
    return code + step, _move(xp, camera, change)


def _camera_rows(xp, sight: Sight):
    """Derivatives of the image by rotation, log scale, perspective and shift, and the residual.

    Returns:
        `(n, 8, 2 L)`; the last row is the residual.
    """
    x, y, depth = sight.posed[:, 0:1], sight.posed[:, 1:2], sight.posed[:, 2:3]
    nothing = 0 * depth
    swing = sight.along * depth
    rows = [
        sight.across[:, :1] * y,
        sight.across[:, 1:] * y - swing,
        swing - sight.across[:, :1] * x,
        -sight.across[:, 1:] * x,
        -sight.seen[:, 1:],
        sight.seen[:, :1],
        sight.seen,
        sight.near * depth * sight.seen,
        sight.certainty,
        nothing,
        nothing,
        sight.certainty,
        xp.reshape(sight.residual, (-1, *sight.seen.shape[1:])),
    ]
    return xp.reshape(xp.concatenate(rows, 1), (-1, 8, 2 * depth.shape[2]))


def _move(xp, camera: Camera, change) -> Camera:
    """The camera after a step `(n, 7)`; the rotation is the Cayley transform of half the vector."""
    half = change[:, :3] / 2
    x, y, z = half[:, 0:1], half[:, 1:2], half[:, 2:3]
    nothing = 0 * x
    turn = xp.concatenate([nothing, -z, y, z, nothing, -x, -y, x, nothing], 1)
    turn = xp.reshape(turn, (-1, 3, 3))
    turned = turn @ camera.rotation
    length = _dot(half, half)[:, :, None]
    rotation = camera.rotation + 2 / (1 + length) * (turned + turn @ turned)
    growth = xp.exp(xp.clip(change[:, 3:4], -_LONGEST_STEP, _LONGEST_STEP))
    perspective = camera.perspective + change[:, _PERSPECTIVE : _PERSPECTIVE + 1]
    perspective = xp.clip(perspective, -_MOST_PERSPECTIVE, _MOST_PERSPECTIVE)
    return Camera(rotation, camera.scale * growth, perspective, camera.shift + change[:, 5:])


def _dot(a, b):
    return (a[:, None] @ b[:, :, None])[:, :, 0]


def _flat(xp, array):
    return xp.reshape(array, (-1, array.shape[1] * array.shape[2]))
