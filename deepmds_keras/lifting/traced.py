"""A lifter as a graph of array operations, for programs that are not in Python."""

from typing import NamedTuple

import numpy as np

from deepmds_keras.lifting.lifter import LandmarkLifter
from deepmds_keras.lifting.onnx_graph import Graph, Tensor, Tracer
from deepmds_keras.lifting.unrolled_fit import UNIT, lift


class TracedLifter(NamedTuple):
    """The graph, its inputs, and its outputs by name."""

    graph: Graph
    inputs: list[Tensor]
    outputs: dict[str, Tensor]


@np.errstate(all="ignore")  # of the examples
def trace(lifter: LandmarkLifter) -> TracedLifter:
    """The graph of `LandmarkLifter.estimate`, with what `prepare_views` does, in float32."""
    graph, xp, n_landmarks = Graph(), Tracer(), lifter.n_landmarks
    view = graph.input("view", (n_landmarks, 2))
    visible = graph.input("visible", (n_landmarks,), "?")
    landmark_sd = graph.input("landmark_sd", (n_landmarks,))

    points = xp.transpose(view, (0, 2, 1))
    known = visible & ~(xp.isnan(points[:, 0]) | xp.isnan(points[:, 1]))
    points = xp.where(known[:, None], points, 0)
    seen = xp.float32(known)
    share = xp.mean(seen, 1, keepdims=True)[:, None]
    middles = []
    for _ in range(2):  # the second pass removes rounding errors
        middles.append(xp.mean(points, 2, keepdims=True) / share)
        points = (points - middles[-1]) * seen[:, None]
    centre = middles[1] + middles[0]
    square = xp.mean(points * points, 2, keepdims=True) / share
    radius = xp.sqrt(xp.sum(square, 1, keepdims=True))
    sd = landmark_sd / radius[:, 0]
    sd = xp.where(xp.isnan(sd) | ~known, lifter.default_sd_, sd)
    lifted = lift(xp, lifter.weights_, points / radius, seen, sd)
    shape, log_sd = (xp.transpose(a, (0, 2, 1)) for a in (lifted.shapes, lifted.log_sd))
    camera, radius = lifted.camera, radius[:, 0]
    outputs = {
        "shape": shape,
        "shape_sd": UNIT * xp.exp(log_sd),
        "rotation": camera.rotation,
        "scale": (camera.scale * radius)[:, 0],
        "translation": camera.shift * radius + centre[:, :, 0],
        "perspective": camera.perspective[:, 0],
    }
    return TracedLifter(graph, [view, visible, landmark_sd], outputs)
