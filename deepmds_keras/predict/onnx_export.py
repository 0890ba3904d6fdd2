"""A trained lifter as an ONNX model, which runs without this package, on phones and in browsers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from deepmds_keras import __version__
from deepmds_keras.errors import InputError, needs
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.landmarks.conversion import scheme_of
from deepmds_keras.lifting.network import SIZES, UNIT, lift
from deepmds_keras.lifting.onnx_graph import TYPES, Graph, Tracer
from deepmds_keras.lifting.trained import TrainedLifter
from deepmds_keras.predict.models import weights_path
from deepmds_keras.predict.outputs import AXES, SCALE
from deepmds_keras.predict.writing import write_bytes
from deepmds_keras.weights import PRETRAINED

_OPSET, _IR_VERSION = 18, 8  # of the end of 2022, which runtimes in use read
_DOC = """\
3D face landmarks from the 2D landmarks of one image (deepmds-keras). The batch n may be any.
Inputs: view (n, L, 2), x to the right and y UP, any scale and place, NaN where a landmark is
missing; visible (n, L), false where one is missing, at least 6 true; landmark_sd (n, L), standard
deviations of the errors of a coordinate in the unit of the view, NaN for that of the training.
Outputs: shape (n, L, 3), and shape_sd (n, L, 3), the standard deviations of its errors; axes and
unit are in the metadata."""


def export(path: str | Path, model: str) -> None:
    """Write a lifter as an ONNX model, complete or not at all.

    Its inputs and outputs are those of `LandmarkLifter.predict`; its metadata say which landmarks
    in which order it takes.

    Args:
        path: Of the model, a new file.
        model: File of `LandmarkLifter.save`, or name of weights that ship.

    Raises:
        InputError: The weights cannot be read, the package onnx is not installed, or the file
            exists or cannot be written.
    """
    if Path(path).exists():
        raise InputError(f"{path} must be the name of a new file. Received one that exists.")
    weights = weights_path(model)
    lifter = TrainedLifter.read(weights)
    scheme = load_scheme(scheme_of(lifter.n_landmarks))
    shipped = weights.parent == PRETRAINED
    source = "shipped with deepmds-keras, MIT licence" if shipped else "given by the user"
    with needs("onnx", "onnx"):
        from onnx import checker, helper
    written = helper.make_model(
        _traced(lifter),
        opset_imports=[helper.make_opsetid("", _OPSET)],
        ir_version=_IR_VERSION,
        producer_name="deepmds-keras",
        producer_version=__version__,
        doc_string=_DOC,
    )
    helper.set_model_props(
        written,
        {
            "scheme": scheme.name,
            "landmark_numbers": json.dumps(scheme.numbers),
            "landmark_names": json.dumps(scheme.names),
            "unit": f"normalised: {SCALE['normalised']}",
            "axes": AXES["shape"],
            "weights": f"{weights.stem}: {source}",
        },
    )
    checker.check_model(written, full_check=True)
    write_bytes(path, written.SerializeToString())


@np.errstate(all="ignore")  # of the examples
def _traced(lifter: TrainedLifter):
    """The graph of `predict`, which does in float32 what `prepare_views` does before."""
    from onnx import helper, numpy_helper

    graph, xp, n_landmarks = Graph(), Tracer(), lifter.n_landmarks
    view = graph.input("view", (n_landmarks, 2))
    visible = graph.input("visible", (n_landmarks,), "?")
    landmark_sd = graph.input("landmark_sd", (n_landmarks,))
    inputs = [view, visible, landmark_sd]

    points = xp.transpose(view, (0, 2, 1))
    known = visible & ~(xp.isnan(points[:, 0]) | xp.isnan(points[:, 1]))
    points = xp.where(known[:, None], points, 0)
    seen = xp.float32(known)
    share = xp.mean(seen, 1, keepdims=True)[:, None]
    for _ in range(2):  # the second time takes off what was rounded
        points = (points - xp.mean(points, 2, keepdims=True) / share) * seen[:, None]
    square = xp.mean(points * points, 2, keepdims=True) / share
    radius = xp.sqrt(xp.sum(square, 1, keepdims=True))
    sd = landmark_sd / radius[:, 0]
    sd = xp.where(xp.isnan(sd), lifter.training_sd_, sd)
    lifted = lift(xp, lifter.weights_, SIZES[lifter.size].iterations, points / radius, seen, sd)
    shape, log_sd = (xp.transpose(a, (0, 2, 1)) for a in (lifted.shapes, lifted.log_sd))
    outputs = {"shape": shape, "shape_sd": UNIT * xp.exp(log_sd)}

    def described(name, tensor):
        kind = TYPES[tensor.example.dtype.kind]
        return helper.make_tensor_value_info(name, kind, ["n", *tensor.shape[1:]])

    return helper.make_graph(
        [
            *(helper.make_node(kind, inputs, [output], **attributes)
              for kind, inputs, output, attributes in graph.nodes),
            *(helper.make_node("Identity", [tensor.name], [name])
              for name, tensor in outputs.items()),
        ],
        "lifter",
        [described(tensor.name, tensor) for tensor in inputs],
        [described(name, tensor) for name, tensor in outputs.items()],
        [numpy_helper.from_array(array, name) for name, array in graph.constants.items()],
    )  # fmt: skip
