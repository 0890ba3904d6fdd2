"""One self-contained HTML page of 3D faces that can be turned, each next to its photo."""

from __future__ import annotations

import html
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from deepmds_keras import __version__
from deepmds_keras.files import write_bytes
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.tool.command.outputs import AXES, SCALE, or_null
from deepmds_keras.tool.command.overlay import cut_out
from deepmds_keras.tool.html_parts import (
    STYLE,
    WIREFRAME,
    filled,
    in_base64,
    json_in_html,
)
from deepmds_keras.tool.predict.faces import Face
from deepmds_keras.tool.predict.mesh import fit_surfaces, surface_triangles

_FOLDER = Path(__file__).parent
_DIGITS = {"mm": 2}  # after the point; normalised shapes get more
_BARE_SIDE, _BARE_MARGIN = 1000, 120  # of a drawing without a photo
_MOST = 32767  # of an int16


def write_page(
    path: str | Path,
    faces: Sequence[Face],
    photos: Sequence[np.ndarray | None],
    *,
    mesh: bool = False,
) -> None:
    """Write the page, whole or not at all.

    It contains the part of each photo around the face, and needs no network: its policy forbids it
    to load anything, or to run any script but its own.

    Args:
        path: Path of the page.
        faces: Faces in the order in which they are shown.
        photos: The whole photo of each face, `(H, W, 3)` uint8 RGB, or None if it has none.
        mesh: Whether to show the heads through the landmarks.

    Raises:
        InputError, OSError: As for `atomic_write`.
    """
    described = [_described(face, photo) for face, photo in zip(faces, photos, strict=True)]
    schemes = {
        name: {"lines": scheme.polylines, "names": scheme.names, "numbers": scheme.numbers}
        for name, scheme in ((face.scheme, load_scheme(face.scheme)) for face in faces)
    }
    shown = {"faces": described, "schemes": schemes, "axes": AXES["shape"]}
    if mesh:
        shown["triangles"] = in_base64(surface_triangles().astype("<u2").tobytes())
        for face, shown_face in zip(faces, described, strict=True):
            shown_face["mesh"] = _mesh(face)
    thing, n = load_scheme(faces[0].scheme).thing, len(faces)
    title = f"3D {thing} of {faces[0].name}" if n == 1 else f"{n} {thing}s in 3D"
    page = (_FOLDER / "page.html").read_text(encoding="utf-8")
    values = {
        "style": STYLE,
        "script": WIREFRAME,
        "version": __version__,
        "title": html.escape(title),
        "faces": json_in_html(shown),
    }
    page = filled(page, values, {"img-src": "data:"})
    # A file name may contain bytes that are not text.
    write_bytes(path, page.encode("utf-8", "replace"))


def _described(face: Face, photo: np.ndarray | None) -> dict:
    digits = _DIGITS.get(face.unit, 4)
    extent = np.ptp(face.landmarks_3d[:, :2], axis=0).max()
    image_digits = max(3, 5 - int(np.floor(np.log10(extent))))  # not all are in pixels
    return {
        "name": face.name,
        "source": face.source and face.source.name,  # without its folder: pages are passed on
        "scheme": face.scheme,
        "unit": face.unit,
        "scale": SCALE[face.unit],
        "digits": digits,
        "points": np.round(face.xyz, digits + 1).tolist(),
        "image_digits": image_digits,
        "landmarks": or_null(np.round(face.landmarks, image_digits)),
        "pose": {name: getattr(face.pose, name) for name in ("yaw", "pitch", "roll", "residual")},
        "notes": face.notes,
        "photo": _picture(face, photo),
    }


def _picture(face: Face, photo: np.ndarray | None) -> dict:
    """Picture next to the shape; in its pixels the landmarks, and the shape in the head's pose."""
    seen = face.landmarks_3d[:, :2]
    if photo is None:
        low, extent = seen.min(0), np.ptp(seen, axis=0)
        scale, jpeg = _BARE_SIDE / extent.max(), None
        width, height = scale * extent + 2 * _BARE_MARGIN

        def place(points):
            return scale * (points - low) + _BARE_MARGIN
    else:
        cutout, buffer = cut_out(photo, seen), io.BytesIO()
        cutout.image.save(buffer, "jpeg", quality=85, optimize=True)
        jpeg = "data:image/jpeg;base64," + in_base64(buffer.getvalue())
        place, (width, height) = cutout.place, cutout.image.size
    return {
        "jpeg": jpeg,
        "width": round(float(width), 1),
        "height": round(float(height), 1),
        "landmarks": or_null(np.round(place(face.landmarks), 1)),
        "shape": np.round(place(face.seen_shape), 1).tolist(),
    }


def _mesh(face: Face) -> dict:
    """Vertices of the head, as integer steps from the lowest."""
    vertices = fit_surfaces(face.xyz[None], face.scheme)[0].astype(float)
    lowest = vertices.min(0)
    step = np.ptp(vertices, axis=0).max() / _MOST
    steps = np.round((vertices - lowest) / step).astype("<i2")
    return {"lowest": lowest.tolist(), "step": step, "vertices": in_base64(steps.tobytes())}
