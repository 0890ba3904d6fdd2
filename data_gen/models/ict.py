"""ICT-FaceKit Light: the official folder of OBJ files, or the same compiled to one npz file.

Li et al. 2020, "Learning formation of physically-based face attributes" (CVPR); MIT licence,
github.com/ICT-VGL/ICT-FaceKit.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from data_gen.models.mesh import orient_outwards
from data_gen.models.model_files import (
    expect_format,
    find_path,
    known_landmarks,
    model_of,
)
from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.errors import InputError, brief
from deepmds_keras.files import read_npz, sha256_of

CANDIDATES = (
    "generic_neutral_mesh.obj",
    "FaceXModel",
    "ICT-FaceKit/FaceXModel",
    "ict_light.npz",
    "ict-facekit/ict_light.npz",
)
N_IDENTITY = 100
_MM = 10.0  # the files are in centimetres
_NEUTRAL = "generic_neutral_mesh.obj"
# Kinds of the arrays of the npz.
_KINDS = {
    **{"mean": "fiu", "identity": "fiu", "expression": "fiu", "expression_names": "U"},
    **{"triangles": "iu", "vertex_index": "iu"},
}


@np.errstate(over="ignore", invalid="ignore")  # what is too large is refused in the end
def load_ict(path: str | Path) -> MorphableModel:
    """Reads ICT-FaceKit Light; the origin stays where the files have it.

    Args:
        path: `FaceXModel` (`generic_neutral_mesh.obj`, `identityNNN.obj`, one OBJ an expression),
            a folder that holds it, or the compiled npz or its folder. The npz has `mean` (V, 3),
            `identity` (K, V, 3), `expression` (E, V, 3), `expression_names`, `triangles` and
            `vertex_index` (V,), the vertices' numbers in the OBJ files; centimetres.

    Returns:
        The model; landmarks `"bfm72"` and `"ibug68"` where the mesh has all their vertices.

    Raises:
        InputError: A file is missing, malformed or of another mesh.
    """
    found = find_path(path, CANDIDATES, what="ICT-FaceKit")
    if found.name == _NEUTRAL:
        found = found.parent
    return _load_folder(found) if found.is_dir() else _load_npz(found)


def _load_folder(folder: Path) -> MorphableModel:
    neutral_file = folder / _NEUTRAL
    identity_files = [folder / f"identity{k:03}.obj" for k in range(N_IDENTITY)]
    for file in (neutral_file, *identity_files):
        if not file.is_file():
            raise InputError(
                f"{folder}: must hold {_NEUTRAL} and identity000.obj to "
                f"{identity_files[-1].name}. Received none of the name {file.name}."
            )
    others = {neutral_file, *folder.glob("identity[0-9]*.obj")}
    expression_files = sorted({*folder.glob("*.obj")} - others)
    mean, triangles = _read_obj(neutral_file)
    landmarks = known_landmarks("ict", np.arange(len(mean)))
    _check_official_landmarks(folder / "vertex_indices.json", landmarks)
    return model_of(
        folder,
        name="ict",
        mean=mean * _MM,
        identity_basis_times_sd=_read_offsets(identity_files, mean),
        triangles=orient_outwards(mean, triangles),
        landmarks=landmarks,
        expression_basis=_read_offsets(expression_files, mean) if expression_files else None,
        expression_names=tuple(file.stem for file in expression_files),
        sha256=sha256_of([neutral_file, *identity_files, *expression_files]),
    )


def _load_npz(file: Path) -> MorphableModel:
    expect_format(file, b"PK", "an npz file")
    arrays = read_npz(file)
    for key, kinds in _KINDS.items():
        if key not in arrays or arrays[key].dtype.kind not in kinds:
            found = f"{key} of type {arrays[key].dtype}" if key in arrays else f"no {key}"
            raise InputError(f"{file}: must hold arrays {', '.join(_KINDS)}. Received {found}.")
    mean = arrays["mean"].astype(np.float64)
    identity, expression = (arrays[key].astype(np.float32) for key in ("identity", "expression"))
    names = tuple(map(str, arrays["expression_names"].ravel()))
    triangles, numbers = arrays["triangles"].astype(int), arrays["vertex_index"].astype(int)
    if mean.ndim != 2 or mean.shape[1] != 3 or numbers.shape != mean.shape[:1]:
        raise InputError(
            f"{file}: mean and vertex_index must be (V, 3) and (V,). "
            f"Received {mean.shape} and {numbers.shape}."
        )
    if (np.diff(numbers) <= 0).any():
        raise InputError(f"{file}: vertex_index must ascend. Received numbers out of order.")
    if expression.ndim != 3 or len(names) != len(expression):
        n_expressions = expression.shape[0] if expression.ndim else "no"
        raise InputError(
            f"{file}: expression_names must name {n_expressions} expressions. "
            f"Received {len(names)}."
        )
    _check_triangles(file, triangles, len(mean))
    return model_of(
        file,
        name="ict",
        mean=mean * _MM,
        identity_basis_times_sd=identity * np.float32(_MM),
        triangles=orient_outwards(mean, triangles),
        landmarks=known_landmarks("ict", numbers),
        expression_basis=expression * np.float32(_MM),
        expression_names=names,
        sha256=sha256_of([file]),
    )


def _read_offsets(files: list[Path], mean: np.ndarray) -> np.ndarray:
    offsets = np.empty((len(files), *mean.shape), np.float32)
    for offset, file in zip(offsets, files, strict=True):
        vertices = _read_vertices(file, _read_lines(file))
        if vertices.shape != mean.shape:
            raise InputError(
                f"{file}: must have the {len(mean)} vertices of {_NEUTRAL}. "
                f"Received {len(vertices)}."
            )
        offset[:] = (vertices - mean) * _MM
    return offsets


def _read_obj(file: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices as written, and triangles, 0-based; a polygon becomes a fan."""
    lines = _read_lines(file)
    vertices = _read_vertices(file, lines)
    corners = [
        [word.partition(b"/")[0] for word in line.split()[1:]]
        for line in lines
        if line.startswith(b"f ")
    ]
    try:
        triangles = [
            (face[0], face[k], face[k + 1]) for face in corners for k in range(1, len(face) - 1)
        ]
        triangles = np.array([[*map(int, face)] for face in triangles], int).reshape(-1, 3) - 1
    except (ValueError, OverflowError) as error:
        raise InputError(
            f"{file}: faces must be vertex numbers. Received {brief(error)}."
        ) from error
    _check_triangles(file, triangles, len(vertices))
    return vertices, triangles


def _read_lines(file: Path) -> list[bytes]:
    try:
        return file.read_bytes().splitlines()
    except OSError as error:
        raise InputError(f"{file}: must be a readable OBJ file. Received {error}.") from error


def _read_vertices(file: Path, lines: list[bytes]) -> np.ndarray:
    rows = [line[2:] for line in lines if line.startswith(b"v ")]
    if not rows:
        raise InputError(f"{file}: must be an OBJ file with vertices. Received none.")
    try:
        # Not by way of an array of the words: one that is long would make all of them as long.
        numbers = np.fromiter(map(float, b" ".join(rows).split()), np.float64)
        return numbers.reshape(len(rows), 3)
    except ValueError as error:
        raise InputError(
            f"{file}: must be an OBJ file with three coordinates a vertex. Received {brief(error)}."
        ) from error


def _check_triangles(file: Path, triangles: np.ndarray, n_vertices: int) -> None:
    if triangles.ndim != 2 or triangles.shape[1] != 3 or not triangles.size:
        raise InputError(f"{file}: triangles must be (T, 3). Received {triangles.shape}.")
    if triangles.min() < 0 or triangles.max() >= n_vertices:
        raise InputError(
            f"{file}: triangles must number {n_vertices} vertices from 0. "
            f"Received {triangles.min()} to {triangles.max()}."
        )


def _check_official_landmarks(file: Path, landmarks: dict[str, np.ndarray]) -> None:
    """The folder's own list of 68 must be our table's, or its numbering is another's."""
    if "ibug68" not in landmarks or not file.is_file():
        return
    try:
        official = json.loads(file.read_text(encoding="utf-8"))["idx_to_landmark_verts"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(
            f"{file}: must list idx_to_landmark_verts. Received {brief(repr(error))}."
        ) from error
    if not np.array_equal(official, landmarks["ibug68"]):
        raise InputError(
            f"{file}: idx_to_landmark_verts must be the 68 vertices of ICT-FaceKit Light. "
            "Received others."
        )
