"""What the scripts of the live page know about landmarks, detector, lifter and files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.landmarks import convert, load_scheme, scheme_of
from deepmds_keras.landmarks.y_axis import eyes_to_mouth
from deepmds_keras.lifting.lifter import LandmarkLifter
from deepmds_keras.lifting.traced import trace
from deepmds_keras.tool.command.outputs import AXES, common, description
from deepmds_keras.tool.detection import DETECTORS, describe_detector, measured
from deepmds_keras.tool.html_parts import in_base64
from deepmds_keras.tool.predict.models import describe_model, load_model, name_for

_DETECTOR = "mediapipe"
_FRAME = (
    "frame: of those analysed since the start, from 0; time: seconds since the first; track: one "
    "number for each face, the same from frame to frame; smoothed: whether its landmarks are, over "
    "time, by a One Euro filter. Where no face is found, there is no row"
)


def settings(lifter: LandmarkLifter, model: str) -> dict:
    """All of it, for JSON; `model` is the lifter's name or file.

    Raises:
        InputError: The detector does not find the lifter's landmarks.
    """
    scheme = scheme_of(lifter.n_landmarks)
    rows = measured(_DETECTOR, scheme)
    if rows is None:
        raise InputError(
            f"model must have the landmarks that MediaPipe finds, ibug51. Received {model}, with "
            f"{scheme}."
        )
    of = load_scheme(scheme)
    mean = lifter.weights_["mean"].T.astype(float)
    # Without its folder: pages are passed on.
    described = describe_model(scheme, model) | {"name": Path(model).name}
    known = common(scheme, "normalised", describe_detector(_DETECTOR, None), described)
    found = DETECTORS[_DETECTOR].scheme
    positions = np.repeat(np.arange(len(load_scheme(found)))[:, None], 2, axis=1)
    # The vector from eyes to mouth is a sum of landmarks, each times a number.
    each = np.eye(len(of))[:, :, None] * (1, 0)
    axes = {key: AXES[key] for key in ("shape", "landmarks", "std")}
    axes["pose"] = AXES["pose"].partition(". ")[0]
    return {
        "scheme": {"names": of.names, "numbers": of.numbers, "lines": of.polylines},
        "detector": {
            "picks": convert(positions, found, scheme)[:, 0].astype(int).tolist(),
            "down": eyes_to_mouth(each, scheme)[:, 0].tolist(),
            "offsets": rows[:, :2].tolist(),
            "sd": rows[:, 2].tolist(),
        },
        "graph": _graph(lifter),
        "turns": load_model(name_for(scheme, model)).turns,
        "around": mean.tolist(),
        "about": {
            "csv": [
                *description(known),
                f"std_x, std_y, std_z: {AXES['std']}",
                f"image_x, image_y: {AXES['landmarks']}",
                _FRAME,
            ],
            "json": known
            | {"axes": axes, "frame": _FRAME}
            | {"landmark_numbers": of.numbers, "landmark_names": of.names},
        },
    }


def _graph(lifter: LandmarkLifter) -> dict:
    """What `graph.js` runs: the lifter for one face."""
    graph, inputs, outputs = trace(lifter)
    constants = {
        name: {"dims": value.shape}
        | ({"whole": value.tolist()} if value.dtype.kind == "i"
           else {"floats": in_base64(value.astype("<f4").tobytes())})
        for name, value in graph.constants.items()
    }  # fmt: skip
    return {
        "inputs": {tensor.name: (1, *tensor.shape[1:]) for tensor in inputs},
        "constants": constants,
        "nodes": graph.nodes,
        "outputs": {name: tensor.name for name, tensor in outputs.items()},
    }
