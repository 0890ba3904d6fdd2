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
from deepmds_keras.predict.surface import fit_surfaces, surface_triangles
from deepmds_keras.predict.writing import write_bytes

_FOLDER = Path(__file__).parent
_DIGITS = {"mm": 2}  # after the point; of what is normalised more
_BARE_SIDE, _BARE_MARGIN = 1000, 120  # of a drawing without a photo
_MOST = 32767  # of an int16
_HASHED = re.compile(r"<(script|style)>(.*?)</\1>", re.DOTALL)


def write_page(
    path: str | Path,
    faces: Sequence[Face],
    photos: Iterable[np.ndarray | None],
    *,
    mesh: bool = False,
) -> None:
    """Write the page, complete or not at all.

    It holds the part of each photo about the face, and needs no network: its policy forbids it to
    load anything, and to run any script but its own.

    Args:
        path: Of the page.
        faces: In the order in which they are shown.
        photos: Of each face the whole photo, `(H, W, 3)` uint8 RGB, or None if it has none. Read
            one by one: of a generator only one is in memory.
        mesh: Whether to show the heads through the landmarks.

    Raises:
        InputError: The file cannot be written.
    """
    described = [_described(face, photo) for face, photo in zip(faces, photos, strict=True)]
    schemes = {name: _scheme(name) for name in {face.scheme for face in faces}}
    shown = {"faces": described, "schemes": schemes, "axes": AXES["shape"]}
    if mesh:
        shown["triangles"] = _base64(surface_triangles().astype("<u2").tobytes())
        for face, shown_face in zip(faces, described, strict=True):
            shown_face["mesh"] = _mesh(face)
    title = f"3D face of {faces[0].name}" if len(faces) == 1 else f"{len(faces)} faces in 3D"
    script = wireframe_script() + (_FOLDER / "mesh.js").read_text(encoding="utf-8")
    fill_page(
        path,
        "page.html",
        {"title": html.escape(title), "faces": json_in_html(shown)},
        wireframe=script,
    )


def fill_page(path: str | Path, template: str, values: dict[str, str], **scripts: str) -> None:
    """Write a template of this folder with values for its fields, complete or not at all.

    Args:
        path: Of the page.
        template: Name of the file. A field is `{{name}}`; `policy` and `version` are known.
        values: HTML of the others.
        scripts: By field, of which the policy must know; filled in first.

    Raises:
        InputError: The file cannot be written.
    """
    text = (_FOLDER / template).read_text(encoding="utf-8")
    for name, script in scripts.items():
        text = text.replace(f"{{{{{name}}}}}", script)
    values = {"policy": _policy(text), "version": __version__, **values}
    # In one go, so that a name that looks like a field stays a name.
    page = re.sub(r"\{\{(\w+)\}\}", lambda field: values[field[1]], text)
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
        "photo": _picture(face, photo),
    }


def _picture(face: Face, photo: np.ndarray | None) -> dict:
    """Picture beside the shape; in its pixels the landmarks, and the shape as the head turns."""
    if photo is None:
        low, extent = face.landmarks.min(0), np.ptp(face.landmarks, axis=0)
        scale, jpeg = _BARE_SIDE / extent.max(), None
        width, height = scale * extent + 2 * _BARE_MARGIN

        def place(points):
            return scale * (points - low) + _BARE_MARGIN
    else:
        cutout = cut_out(photo, face.landmarks)
        place, jpeg, (height, width) = cutout.place, _data_uri(cutout), cutout.image.shape[:2]
    return {
        "jpeg": jpeg,
        "width": round(float(width), 1),
        "height": round(float(height), 1),
        "landmarks": np.round(place(face.landmarks), 1).tolist(),
        "shape": np.round(place(face.seen_shape), 1).tolist(),
    }


def _mesh(face: Face) -> dict:
    """Vertices of the head, as whole steps from the lowest."""
    vertices = fit_surfaces(face.shape[None], face.scheme)[0].astype(float)
    lowest = vertices.min(0)
    step = np.ptp(vertices, axis=0).max() / _MOST
    steps = np.round((vertices - lowest) / step).astype("<i2")
    return {"lowest": lowest.tolist(), "step": step, "vertices": _base64(steps.tobytes())}


def _data_uri(cutout: Cutout) -> str:
    buffer = io.BytesIO()
    Image.fromarray(cutout.image).save(buffer, "jpeg", quality=85, optimize=True)
    return "data:image/jpeg;base64," + _base64(buffer.getvalue())


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode()


def _scheme(name: str) -> dict:
    scheme = load_scheme(name)
    return {"lines": scheme.polylines, "names": scheme.names, "numbers": scheme.numbers}


def _policy(template: str) -> str:
    """Content-Security-Policy: only the page's own scripts run, only pictures beside it load."""
    allowed = {"script": [], "style": []}
    for kind, content in _HASHED.findall(template):
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        allowed[kind].append(f"'sha256-{digest}'")
    scripts, styles = (" ".join(hashes) or "'none'" for hashes in allowed.values())
    pictures = "data:" if allowed["script"] else "'self' file:"
    return (
        f"default-src 'none'; img-src {pictures}; script-src {scripts}; style-src {styles}; "
        "base-uri 'none'; form-action 'none'"
    )
