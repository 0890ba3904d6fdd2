"""The lifting network: its weights and its output."""

from typing import NamedTuple

import numpy as np

from deepmds_keras.lifting.equations import (
    Camera,
    back_project,
    look,
    posterior_step,
    starting_camera,
)
from deepmds_keras.streams import Stream

UNIT = 0.01  # of the basis and the standard deviations, in which all weights are of order 1
_ITERATIONS = (1, 6)  # conjugate gradient iterations of each step
_RANK = 64  # coefficients of the code
_N_HIDDEN = 48  # units that correct the code
_N_SPREAD = 16  # units that predict the standard deviation
_N_STATE = 8  # inputs of the hidden units besides the code
_LEAST_VARIANCE = 1e-8
# At most one in eight training views lies below. The learnt correction would extrapolate far below
# it, and go astray on a view that the basis fits exactly, such as that of the mean face.
_LEAST_MISFIT = 0.15
_FIRST_FLOOR = -4.0  # initial log standard deviation of exact landmarks


class Lift(NamedTuple):
    """Output of the network: float32 arrays with the landmarks last."""

    shapes: np.ndarray  # (n, 3, L), centred
    log_sd: np.ndarray  # (n, 3, L), log of the standard deviation in UNITs
    camera: Camera


def initial_weights(shapes: np.ndarray, seed: int) -> dict[str, np.ndarray]:
    """Weights that make the network a fit of the shapes' principal components.

    Shapes are `(n, 3, L)`, centred; of few faces or landmarks the rank is lower. The seed is of the
    kernels.
    """
    n, _, n_landmarks = shapes.shape
    flat = shapes.reshape(n, -1).astype(float)
    mean = flat.mean(0)
    covariance = (flat - mean).T @ (flat - mean) / n
    values, vectors = np.linalg.eigh(covariance)
    rank = min(_RANK, n - 1, len(values))
    basis = (vectors * np.sqrt(values.clip(0))).T[::-1][:rank]
    rest = (np.diag(covariance) - (basis**2).sum(0)).clip(_LEAST_VARIANCE)
    known = {
        "mean": mean.reshape(3, -1),
        "basis": basis / UNIT,
        "log_rest": np.log(rest).reshape(3, -1) / 2,
        "log_floor": np.full(len(_ITERATIONS) + 1, _FIRST_FLOOR),
    }
    rng = np.random.default_rng([seed, Stream.LIFTING_WEIGHTS])
    for name, shape in _shapes(n_landmarks, rank).items():
        if name.endswith("hidden_kernel"):
            known[name] = rng.standard_normal(shape) / np.sqrt(shape[0])
        known.setdefault(name, np.zeros(shape))
    return {name: np.asarray(array, np.float32) for name, array in known.items()}


def check_weights(weights: dict[str, np.ndarray], n_landmarks: int) -> None:
    """Check that weights are of a network for that many landmarks.

    Raises:
        ValueError: One is missing, not finite, or of another shape.
    """
    rank = len(weights["basis"])
    needed = _shapes(n_landmarks, rank)
    for name in {**needed, **weights}:
        array = weights.get(name, np.empty(0, object))
        if array.dtype.kind != "f" or array.shape != needed.get(name):
            raise ValueError(f"{name} has shape {array.shape}, not {needed.get(name)}")
        if not np.isfinite(array).all():
            raise ValueError(f"{name} has NaN or infinity")


def _shapes(n_landmarks: int, rank: int) -> dict[str, tuple[int, ...]]:
    return {
        "mean": (3, n_landmarks),
        "basis": (rank, 3 * n_landmarks),
        "log_rest": (3, n_landmarks),
        "log_floor": (len(_ITERATIONS) + 1,),
        "hidden_kernel": (rank + _N_STATE, _N_HIDDEN),
        "hidden_bias": (_N_HIDDEN,),
        "code_kernel": (_N_HIDDEN, rank),
        "spread_hidden_kernel": (rank + _N_STATE, _N_SPREAD),
        "spread_hidden_bias": (_N_SPREAD,),
        "spread_kernel": (_N_SPREAD, 3 * n_landmarks),
        "spread_bias": (3 * n_landmarks,),
        "spread_unseen": (n_landmarks,),
    }


def lift(xp, weights, views, visible, sd, stop_gradient=lambda x: x) -> Lift:
    """Shapes, standard deviations and cameras of views.

    Args:
        xp: NumPy or `keras.ops`.
        weights: Arrays as from `initial_weights`.
        views: `(n, 2, L)` centred views of unit root mean square radius, 0 where not visible.
        visible: `(n, L)` 1 or 0.
        sd: `(n, L)` standard deviation of the errors of a coordinate, in the unit of the views.
        stop_gradient: Applied to the inputs of the standard deviation, so that learning it
            does not change the shapes.
    """
    mean, basis = weights["mean"], weights["basis"] * UNIT
    n_landmarks = mean.shape[1]
    rest = xp.exp(2 * weights["log_rest"])
    rest_mean = xp.mean(rest, 0)
    floor = xp.exp(2 * weights["log_floor"])
    noise = sd * sd
    camera = starting_camera(xp, views, visible, mean)
    shapes = 0 * views[:, :1] + mean
    code = 0 * views[:, 0, :1] + np.zeros(basis.shape[0], np.float32)

    def seen(i):
        variance = noise + floor[i] + camera.scale * camera.scale * rest_mean
        return look(xp, camera, shapes, views, visible, variance)

    def with_code():
        return mean + xp.reshape(code @ basis, (-1, 3, n_landmarks))

    for i, n_iterations in enumerate(_ITERATIONS):
        code, camera = posterior_step(xp, camera, seen(i), basis, code, n_iterations)
        shapes = with_code()
    sight = seen(len(_ITERATIONS))
    share = xp.mean(visible, 1, keepdims=True)
    misfit = xp.mean(sight.residual * sight.residual, 1, keepdims=True) / share
    mean_noise = xp.sum(noise * visible, 1, keepdims=True) / (share * n_landmarks)
    state = [
        code,
        camera.rotation[:, 2],
        camera.perspective,
        xp.log(camera.scale),
        xp.log(xp.maximum(misfit, _LEAST_MISFIT)),
        xp.log(mean_noise + floor[-1]) / 2,
        share,
    ]
    state = xp.concatenate(state, 1)
    hidden = state @ weights["hidden_kernel"] + weights["hidden_bias"]
    code = code + hidden / (1 + xp.exp(-hidden)) @ weights["code_kernel"]
    # What the basis does not span: each coordinate has an independent error.
    trusted = back_project(xp, camera, sight, sight.residual)
    shapes = with_code() + rest * xp.reshape(trusted, (-1, 3, n_landmarks))
    spread = stop_gradient(state) @ weights["spread_hidden_kernel"]
    spread = xp.tanh(spread + weights["spread_hidden_bias"])
    log_sd = spread @ weights["spread_kernel"] + weights["spread_bias"]
    unseen = ((1 - visible) * weights["spread_unseen"])[:, None]
    return Lift(shapes, xp.reshape(log_sd, (-1, 3, n_landmarks)) + unseen, camera)
