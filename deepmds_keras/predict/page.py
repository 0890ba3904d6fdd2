"""One self-contained HTML page of 3D faces that can be turned, each beside its photo."""

from __future__ import annotations

import base64
import hashlib
import html
import io
import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from deepmds_keras import __version__
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.predict.cutout import Cutout, cut_out
from deepmds_keras.predict.faces import Face
from deepmds_keras.predict.outputs import AXES, SCALE
from deepmds_keras.predict.writing import write_bytes

_FOLDER = Path(__file__).parent
_DIGITS = {"mm": 2}  # after the point; of what is normalised more
_BARE_SIDE, _BARE_MARGIN = 1000, 120  # of a drawing without a photo
_HASHED = re.compile(r"<(script|style)>(.*?)</\1>", re.DOTALL)


def write_page(
    path: str | Path, faces: Sequence[Face], photos: Iterable[np.ndarray | None]
) -> None:
    """Write the page, complete or not at all.

    It holds the part of each photo about the face, and needs no network: its policy forbids it to
    load anything, and to run any script but its own.

    Args:
        path: Of the page.
        faces: In the order in which they are shown.
        photos: Of each face the whole photo, `(H, W, 3)` uint8 RGB, or None if it has none. Read
            one by one: of a generator only one is in memory.

    Raises:
        InputError: The file cannot be written.
    """
    described = [_described(face, photo) for face, photo in zip(faces, photos, strict=True)]
    schemes = {name: _scheme(name) for name in {face.scheme for face in faces}}
    title = f"3D face of {faces[0].name}" if len(faces) == 1 else f"{len(faces)} faces in 3D"
    template = (_FOLDER / "page.html").read_text(encoding="utf-8")
    template = template.replace("{{wireframe}}", wireframe_script())
    values = {
        "policy": _policy(template),
        "version": __version__,
        "title": html.escape(title),
        "faces": json_in_html({"faces": described, "schemes": schemes, "axes": AXES["shape"]}),
    }
    # In one go, so that a name that looks like a field stays a name.
    page = re.sub(r"\{\{(\w+)\}\}", lambda field: values[field[1]], template)
    # A file name may hold bytes that are no text.
    write_bytes(path, page.encode("utf-8", "replace"))


def wireframe_script() -> str:
    """The JavaScript of `element`, `drawWireframe` and `wireframeButtons`, to be put into a page.

    Comments before them describe them.
    """
    files = (_FOLDER / name for name in ("element.js", "wireframe.js"))
    return "".join(file.read_text(encoding="utf-8") for file in files)


def json_in_html(value: object) -> str:
    """JSON that is safe in a script element: no text in it can end the element or begin another."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    return text.replace("<", r"\u003c").replace(">", r"\u003e").replace("&", r"\u0026")


def _described(face: Face, photo: np.ndarray | None) -> dict:
    digits = _DIGITS.get(face.unit, 4)
    return {
        "name": face.name,
        "source": face.source.name,  # not its folder: pages are passed on
        "scheme": face.scheme,
        "unit": face.unit,
        "scale": SCALE[face.unit],
        "digits": digits,
        "points": np.round(face.shape, digits + 1).tolist(),
        "landmarks": np.round(face.landmarks, 3).tolist(),
        "pose": {name: getattr(face.pose, name) for name in ("yaw", "pitch", "roll", "residual")},
        "notes": face.notes,
        "photo": _picture(face.landmarks, photo),
    }


def _picture(landmarks: np.ndarray, photo: np.ndarray | None) -> dict:
    """Picture beside the shape, and the landmarks in its pixels."""
    if photo is None:
        low, extent = landmarks.min(0), np.ptp(landmarks, axis=0)
        scale = _BARE_SIDE / extent.max()
        points, jpeg = scale * (landmarks - low) + _BARE_MARGIN, None
        width, height = scale * extent + 2 * _BARE_MARGIN
    else:
        cutout = cut_out(photo, landmarks)
        points, jpeg = cutout.landmarks, _data_uri(cutout)
        height, width = cutout.image.shape[:2]
    return {
        "jpeg": jpeg,
        "width": round(float(width), 1),
        "height": round(float(height), 1),
        "landmarks": np.round(points, 1).tolist(),
    }


def _data_uri(cutout: Cutout) -> str:
    buffer = io.BytesIO()
    Image.fromarray(cutout.image).save(buffer, "jpeg", quality=85, optimize=True)
    return "data:image/jpeg;base64," + base64.b64encode(buffer.getvalue()).decode()


def _scheme(name: str) -> dict:
    scheme = load_scheme(name)
    return {"lines": scheme.polylines, "names": scheme.names, "numbers": scheme.numbers}


def _policy(template: str) -> str:
    """Content-Security-Policy by which nothing is loaded and only the page's own scripts run."""
    allowed = {"script": [], "style": []}
    for kind, content in _HASHED.findall(template):
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        allowed[kind].append(f"'sha256-{digest}'")
    scripts, styles = (" ".join(hashes) for hashes in allowed.values())
    return (
        f"default-src 'none'; img-src data:; script-src {scripts}; style-src {styles}; "
        "base-uri 'none'; form-action 'none'"
    )
