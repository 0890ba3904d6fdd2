"""Reads the embedded open head model, built from CC0 MakeHuman assets by `build_openhead`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from data_gen.landmarks import load_vertices
from data_gen.models.model_files import model_of
from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.errors import InputError
from deepmds_keras.files import read_npz, sha256_of

OPENHEAD = Path(__file__).parents[1] / "assets" / "openhead.npz"

KINDS = {"f": "floats", "i": "integers", "U": "text"}
# Key: kind and shape. Letters are sizes that must agree: V vertices, K identity and E expression
# components, T triangles.
LAYOUT = {
    "mean": ("f", ("V", 3)),
    "identity_basis_times_sd": ("f", ("K", "V", 3)),
    "expression_basis": ("f", ("E", "V", 3)),
    "expression_names": ("U", ("E",)),
    "triangles": ("i", ("T", 3)),
    "landmarks72": ("i", (len(load_vertices("bfm72").numbers),)),
    "landmarks68": ("i", (len(load_vertices("ibug68").numbers),)),
    "mirror": ("i", ("V",)),
    "part": ("i", ("V",)),
    "uv": ("f", ("V", 2)),
    "base_vertex": ("i", ("V",)),
    "mask_lips": ("i", ("V",)),
    "mask_face": ("i", ("V",)),
    "mask_ears": ("i", ("V",)),
    "mask_eyelids": ("i", ("V",)),
    "mask_inside_mouth": ("i", ("V",)),
}


def load_openhead(path: str | Path | None = None) -> MorphableModel:
    """The open head: 3,765 vertices, 199 identity components, 51 expressions, mm.

    Its nose tip is at (0, 4.4, 131) mm, as in the Basel Face Model.

    Args:
        path: An `openhead.npz`; None is the one that comes with the package.

    Raises:
        InputError: The file is missing, cut short or not an open head.
    """
    path = OPENHEAD if path is None else Path(path)
    arrays = read_openhead(path)
    of_ibug = arrays["landmarks68"].astype(int)
    return model_of(
        path,
        name="openhead",
        mean=arrays["mean"].astype(float),
        identity_basis_times_sd=arrays["identity_basis_times_sd"].astype(float),
        triangles=arrays["triangles"].astype(int),
        landmarks={
            "bfm72": arrays["landmarks72"].astype(int),
            "ibug68": of_ibug,
            "ibug51": of_ibug[np.array(load_vertices("ibug51").numbers) - 1],
        },
        expression_basis=arrays["expression_basis"].astype(float),
        expression_names=tuple(arrays["expression_names"].tolist()),
        sha256=sha256_of([path]),
    )


def read_openhead(path: str | Path | None = None) -> dict[str, np.ndarray]:
    """All arrays of the file by their names in LAYOUT, for what the shape model leaves out.

    `part` is 0 skin, 1 and 2 right and left eye, 3 and 4 upper and lower teeth; `mirror` the
    vertex on the other side; `mask_*` 0 to 255; `base_vertex` the vertex of MakeHuman's base.obj
    (-1 and -2: right and left pupil, which it lacks).

    Raises:
        InputError: As `load_openhead`.
    """
    path = OPENHEAD if path is None else Path(path)
    kind = "an open head model (python -m data_gen.build_openhead makes one)"
    arrays = read_npz(path, kind)
    if missing := [key for key in LAYOUT if key not in arrays]:
        raise InputError(f"{path} must be {kind}. Received one without {', '.join(missing)}.")
    _check(path, arrays)
    return arrays


def _check(path: Path, arrays: dict[str, np.ndarray]) -> None:
    sizes: dict[str, int] = {}
    for key, (kind, shape) in LAYOUT.items():
        array = arrays[key]
        wanted = tuple(
            sizes.setdefault(size, found) if isinstance(size, str) else size
            for size, found in zip(shape, array.shape, strict=False)
        )
        found = {"u": "i"}.get(array.dtype.kind, array.dtype.kind)
        if array.ndim != len(shape) or array.shape != wanted or found != kind:
            raise InputError(
                f"{path}: {key} must have the shape ({', '.join(map(str, shape))}) and hold "
                f"{KINDS[kind]}. "
                f"Received shape {array.shape} of {array.dtype}."
            )
    for key in ("triangles", "mirror"):
        if arrays[key].size and not 0 <= arrays[key].min() <= arrays[key].max() < sizes["V"]:
            raise InputError(
                f"{path}: {key} must be vertex numbers below {sizes['V']}. "
                f"Received {arrays[key].min()} to {arrays[key].max()}."
            )
