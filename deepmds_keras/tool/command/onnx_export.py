"""A trained lifter as an ONNX model, which runs without this package, on phones and in browsers."""

from __future__ import annotations

import json
from pathlib import Path

from deepmds_keras import __version__
from deepmds_keras.errors import InputError, needs
from deepmds_keras.files import write_bytes
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.lifting.lifter import LandmarkLifter
from deepmds_keras.lifting.onnx_graph import TYPES
from deepmds_keras.lifting.traced import trace
from deepmds_keras.tool.command.outputs import AXES, SCALE
from deepmds_keras.tool.predict.models import (
    DEFAULT,
    FALLBACK,
    FAMILIES,
    scheme_of_model,
    weights_path,
)
from deepmds_keras.weights import PRETRAINED

_OPSET, _IR_VERSION = 18, 8  # from the end of 2022; runtimes in use read them
_DOC = """\
3D landmarks from the 2D landmarks of one image (deepmds-keras). The batch n may be any.
Inputs: view (n, L, 2), x to the right and y UP, any scale and place, NaN where a landmark is
missing; visible (n, L), false where one is missing, at least 6 true; landmark_sd (n, L), standard
deviations of the errors of a coordinate in the unit of the view, NaN for those of good landmarks.
Outputs: shape (n, L, 3), facing the front, and shape_sd (n, L, 3), the standard deviations of its
errors; rotation (n, 3, 3), scale (n), translation (n, 2) and perspective (n) of the camera, which
sees S at P = rotation S, at scale P_xy / (1 - perspective P_z) + translation of the view. Axes and
units are in the metadata."""


def export(path: str | Path, model: str, scheme: str | None = None) -> None:
    """Write a lifter as an ONNX model, whole or not at all.

    Its inputs are those of `LandmarkLifter.estimate`, its outputs the shapes, their standard
    deviations and the camera. Its metadata give the landmarks by number and name, units, axes and
    licence.

    Args:
        path: File to write; it must not exist.
        model: File that `LandmarkLifter.save` wrote, or name of shipped weights.
        scheme: Scheme of its landmarks, as for `load_scheme`; None is a face's, told by their
            number, or unnamed.

    Raises:
        InputError: The weights or the scheme cannot be read or do not fit each other, the package
            onnx is not installed, or the file exists or cannot be written.
    """
    if Path(path).exists():
        raise InputError(f"{path} must be a new file. It already exists.")
    lifter, weights = open_lifter(model)
    described = load_scheme(scheme_of_model(scheme, model, lifter.n_landmarks))
    shipped = weights.parent == PRETRAINED
    source = "shipped with deepmds-keras" if shipped else "given by the user"
    with needs("onnx", "onnx"):
        from onnx import checker, helper
    written = helper.make_model(
        _graph(lifter),
        opset_imports=[helper.make_opsetid("", _OPSET)],
        ir_version=_IR_VERSION,
        producer_name="deepmds-keras",
        producer_version=__version__,
        doc_string=_DOC,
    )
    helper.set_model_props(
        written,
        {
            "scheme": described.name,
            "landmark_numbers": json.dumps(described.numbers),
            "landmark_names": json.dumps(described.names),
            "unit": f"normalised: {SCALE['normalised']}",
            "axes": AXES["shape"],
            "view_axes": "x to the right, y up",
            "camera_axes": "x to the right, y up, z towards the viewer",
            "camera_unit": "that of the view; perspective: one over the unit of the shape",
            "weights": f"{weights.stem}: {source}",
            "licence": "MIT" if shipped else "that of the weights",
        },
    )
    checker.check_model(written, full_check=True)
    write_bytes(path, written.SerializeToString())


def open_lifter(model: str) -> tuple[LandmarkLifter, Path]:
    """A lifter, and the file of its weights, by the name of shipped weights or by its file.

    Raises:
        InputError: It is neither, or the file cannot be read.
    """
    lifters = FAMILIES[DEFAULT].shipped
    model = lifters[FALLBACK] if model == DEFAULT else model
    if model not in lifters.values() and not Path(model).is_file():
        raise InputError(
            f"model must be {', '.join(lifters.values())} or an existing file of "
            "LandmarkLifter.save(): the networks of deepmds are not lifters. "
            f"Received {str(model)!r}."
        )
    weights = weights_path(model)
    return LandmarkLifter.load(weights), weights


def _graph(lifter: LandmarkLifter):
    """The traced lifter as a graph of ONNX."""
    from onnx import helper, numpy_helper

    graph, inputs, outputs = trace(lifter)

    def described(name, tensor):
        kind = TYPES[tensor.example.dtype.kind]
        return helper.make_tensor_value_info(name, kind, ["n", *tensor.shape[1:]])

    # Named, because ONNX Runtime 1.19 to 1.21 confuse nodes without a name, and refuse the model.
    return helper.make_graph(
        [
            *(helper.make_node(kind, inputs, [output], name=output, **attributes)
              for kind, inputs, output, attributes in graph.nodes),
            *(helper.make_node("Identity", [tensor.name], [name], name=name)
              for name, tensor in outputs.items()),
        ],
        "lifter",
        [described(tensor.name, tensor) for tensor in inputs],
        [described(name, tensor) for name, tensor in outputs.items()],
        [numpy_helper.from_array(array, name) for name, array in graph.constants.items()],
    )  # fmt: skip
