"""`deepmds live`: writes a page that shows faces of a camera in 3D, with all it needs inside."""

from __future__ import annotations

import gzip
import html
import re
from pathlib import Path

from deepmds_keras import __version__
from deepmds_keras.errors import InputError
from deepmds_keras.files import write_bytes
from deepmds_keras.tool.command.onnx_export import open_lifter
from deepmds_keras.tool.detection.mediapipe_landmarks import LANDMARKER
from deepmds_keras.tool.html_parts import (
    STYLE,
    WIREFRAME,
    filled,
    in_base64,
    json_in_html,
)
from deepmds_keras.tool.live.settings import settings
from deepmds_keras.tool.live.tasks_vision import read_tasks_vision

_FOLDER = Path(__file__).parent
_SCRIPTS = ("graph.js", "faces.js", "results.js", "live.js")
_ALLOWED = {
    "script-src": "'wasm-unsafe-eval'",
    "connect-src": "blob:",  # the WebAssembly, out of the page itself
    "media-src": "blob:",  # a video that is opened
}


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
        raise InputError(f"{path} must be a new file. It already exists.")
    lifter, _ = open_lifter(model)
    known = settings(lifter, model)
    package = read_tasks_vision(tasks_vision)
    bundle = package["vision_bundle.mjs"].decode()
    exported = re.search(r"\b(\w+) as FaceLandmarker\b", bundle)
    assert exported, "the file of that hash exports it"
    values = {
        "version": __version__,
        "style": STYLE + _text("live.css"),
        "notices": html.escape(_text("notices.txt")),
        "settings": json_in_html(known),
        "model": _packed(LANDMARKER.read_bytes()),
        "wasm": _packed(package["wasm/vision_wasm_internal.wasm"]),
        "loader": package["wasm/vision_wasm_internal.js"].decode(),
        "bundle": f"{bundle}\nself.FaceLandmarker = {exported[1]};\n",
        "script": WIREFRAME + "".join(map(_text, _SCRIPTS)),
    }
    write_bytes(path, filled(_text("live.html"), values, _ALLOWED).encode())


def _text(name: str) -> str:
    return (_FOLDER / name).read_text(encoding="utf-8")


def _packed(content: bytes) -> str:
    return in_base64(gzip.compress(content, mtime=0))
