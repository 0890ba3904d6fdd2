"""`deepmds live`: writes a page that shows faces of a camera in 3D, with all it needs inside."""

from __future__ import annotations

import gzip
import html
import re
from pathlib import Path

import numpy as np

from deepmds_keras import __version__
from deepmds_keras.errors import InputError
from deepmds_keras.files import write_bytes
from deepmds_keras.geometry.camera import head_pose
from deepmds_keras.landmarks import convert, load_scheme, scheme_of
from deepmds_keras.landmarks.y_axis import eyes_to_mouth
from deepmds_keras.lifting.lifter import LandmarkLifter
from deepmds_keras.lifting.traced import trace
from deepmds_keras.tool.command.html_parts import (
    STYLE,
    WIREFRAME,
    filled,
    in_base64,
    json_in_html,
)
from deepmds_keras.tool.command.onnx_export import open_lifter
from deepmds_keras.tool.command.outputs import AXES, common, description
from deepmds_keras.tool.detection import DETECTORS, describe_detector, measured
from deepmds_keras.tool.live.tasks_vision import read_tasks_vision
from deepmds_keras.tool.predict.faces import Face
from deepmds_keras.tool.predict.models import LifterModel, describe_model

FACE_LANDMARKER = Path(__file__).parents[1] / "detection" / "face_landmarker.task"
_FOLDER = Path(__file__).parent
_DETECTOR = "mediapipe"
_SCRIPTS = ("graph.js", "faces.js", "results.js", "live.js")
_ALLOWED = {
    "script-src": "'wasm-unsafe-eval'",
    "connect-src": "blob:",  # the WebAssembly, out of the page itself
    "media-src": "blob:",  # a video that is opened
}
_FRAME = (
    "frame: of those analysed since the start, from 0; time: seconds since the first; track: one "
    "number for each face, the same from frame to frame; smoothed: whether its landmarks are, over "
    "time, by a One Euro filter. Where no face is found, there is no row"
)


def write_live_page(
    path: str | Path, *, model: str, tasks_vision: str | Path | None = None
) -> None:
    """Write the page, whole or not at all.

    Args:
        path: File to write; it must not exist.
        model: File that `LandmarkLifter.save` wrote, or name of shipped weights, for 51 landmarks.
        tasks_vision: As for `read_tasks_vision`.

    Raises:
        InputError: The file exists, or the model or the package cannot be used.
        OSError: The file cannot be written.
    """
    if Path(path).exists():
        raise InputError(f"{path} must be the name of a new file. Received one that exists.")
    lifter, _ = open_lifter(model)
    scheme = scheme_of(lifter.n_landmarks)
    rows = measured(_DETECTOR, scheme)
    if rows is None:
        raise InputError(
            f"model must be of landmarks that MediaPipe finds, those of ibug51. Received {model}, "
            f"of {scheme}."
        )
    package = read_tasks_vision(tasks_vision)
    bundle = package["vision_bundle.mjs"].decode()
    exported = re.search(r"\b(\w+) as FaceLandmarker\b", bundle)
    assert exported, "the file of that hash exports it"
    values = {
        "version": __version__,
        "style": STYLE + _text("live.css"),
        "notices": html.escape(_text("notices.txt")),
        "settings": json_in_html(_settings(lifter, scheme, rows, model)),
        "model": _packed(FACE_LANDMARKER.read_bytes()),
        "wasm": _packed(package["wasm/vision_wasm_internal.wasm"]),
        "loader": package["wasm/vision_wasm_internal.js"].decode(),
        "bundle": f"{bundle}\nself.FaceLandmarker = {exported[1]};\n",
        "script": WIREFRAME + "".join(map(_text, _SCRIPTS)),
    }
    write_bytes(path, filled(_text("live.html"), values, _ALLOWED).encode())


def _settings(lifter: LandmarkLifter, scheme: str, rows: np.ndarray, model: str) -> dict:
    """What the scripts of the page know about landmarks, detector, lifter and files."""
    of = load_scheme(scheme)
    mean = lifter.weights_["mean"].T.astype(float)
    face = Face(
        name="",
        source=None,
        photo=None,
        scheme=scheme,
        landmarks=mean[:, :2] * (1, -1),
        xyz=mean,
        unit="normalised",
        pose=head_pose(mean[:, :2], mean),
        detector=describe_detector(_DETECTOR, None),
    )
    described = describe_model(scheme, model)
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
        "turns": LifterModel.turns,
        "around": mean.tolist(),
        "about": {
            "csv": [
                *description([face], described),
                f"std_x, std_y, std_z: {AXES['std']}",
                f"image_x, image_y: {AXES['landmarks']}",
                _FRAME,
            ],
            "json": common([face], described)
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


def _text(name: str) -> str:
    return (_FOLDER / name).read_text(encoding="utf-8")


def _packed(content: bytes) -> str:
    return in_base64(gzip.compress(content, mtime=0))
