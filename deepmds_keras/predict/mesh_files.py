"""Writes the head through a face's landmarks as a triangle mesh."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from deepmds_keras.predict.faces import Face
from deepmds_keras.predict.outputs import description
from deepmds_keras.predict.surface import fit_surfaces, surface_triangles
from deepmds_keras.predict.writing import write_bytes

MESH_SUFFIXES = (".mesh.ply", ".mesh.obj")
_WHAT = "mesh: head of the open head model (CC0) through the landmarks; far from them it is a guess"


def write_mesh(path: Path, face: Face, model: Mapping) -> None:
    """Write the mesh of one face, in the frame and unit of its shape, whole or not at all.

    Args:
        path: Ends in one of `MESH_SUFFIXES`; its folder is made if it does not exist.
        face: The face.
        model: What made the shape, as JSON has it.

    Raises:
        InputError: The file cannot be written.
    """
    vertices, triangles = fit_surfaces(face.shape[None], face.scheme)[0], surface_triangles()
    make = _ply if path.suffix == ".ply" else _obj
    text = make([_WHAT, *description([face], model)], vertices, triangles)
    write_bytes(path, text.encode("ascii", "replace"))  # some readers take ASCII only


def _ply(told: list[str], vertices: np.ndarray, triangles: np.ndarray) -> str:
    lines = [
        "ply",
        "format ascii 1.0",
        *(f"comment {line}" for line in told),
        f"element vertex {len(vertices)}",
        *(f"property float {axis}" for axis in "xyz"),
        f"element face {len(triangles)}",
        "property list uchar int vertex_indices",
        "end_header\n",
    ]
    rows = _rows("%.7g %.7g %.7g", vertices) + _rows("3 %d %d %d", triangles)
    return "\n".join(lines) + rows


def _obj(told: list[str], vertices: np.ndarray, triangles: np.ndarray) -> str:
    comments = "".join(f"# {line}\n" for line in told)
    return comments + _rows("v %.7g %.7g %.7g", vertices) + _rows("f %d %d %d", triangles + 1)


def _rows(row: str, numbers: np.ndarray) -> str:
    return (f"{row}\n" * len(numbers)) % tuple(numbers.ravel().tolist())
