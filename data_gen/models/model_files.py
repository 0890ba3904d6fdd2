"""Finding the files of a face model, and refusing what is not one before anything parses it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from data_gen.landmarks import SCHEMES, load_vertices
from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.errors import InputError

_PICKLE_OPCODES = b"(]}c)lN"  # what a text pickle (protocol 0 or 1) of a container begins with


def find_path(path: str | Path, candidates: Iterable[str], *, what: str) -> Path:
    """The model's file or folder, given itself or a folder that holds it.

    Args:
        path: An existing file (returned as it is), or a folder.
        candidates: Paths relative to the folder, the preferred first.
        what: Name of the model, for the message.

    Raises:
        InputError: `path` does not exist, or holds none of the candidates.
    """
    path, candidates = Path(path), list(candidates)
    if path.is_file():
        return path
    if not path.is_dir():
        raise InputError(
            f"{path}: must be the file or folder of {what}, {', '.join(candidates)}. "
            "Received a path that does not exist."
        )
    for candidate in candidates:
        if (path / candidate).exists():
            return path / candidate
    raise InputError(f"{path}: must hold {what} as one of {', '.join(candidates)}. Received none.")


def expect_format(path: Path, magic: bytes, kind: str) -> None:
    """Checks a file's first bytes, so that a wrong file is named before a parser stumbles.

    Args:
        path: The file.
        magic: What it must begin with.
        kind: Its kind with an article, for the message.

    Raises:
        InputError: The file is a pickle (which could run code and is never opened), is another
            kind of file, or cannot be read.
    """
    try:
        with path.open("rb") as file:
            head = file.read(max(len(magic), 8))
            file.seek(0, 2)
            file.seek(max(file.tell() - 1, 0))
            tail = file.read(1)
    except OSError as error:
        raise InputError(f"{path}: must be {kind} that can be read. Received {error}.") from error
    if head.startswith(magic):
        return
    binary_pickle = head[:1] == b"\x80" and len(head) > 1 and head[1] <= 5
    if binary_pickle or (head[:1] in _PICKLE_OPCODES and tail == b"."):
        raise InputError(
            f"{path}: must be {kind}. Received a Python pickle, which can run code when read; "
            "it was not opened."
        )
    raise InputError(f"{path}: must be {kind}. Received a file that begins with {head!r}.")


def model_of(file: Path, **fields) -> MorphableModel:
    """`MorphableModel(**fields)`, whose complaints name the file."""
    try:
        return MorphableModel(**fields)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None


def as_basis(columns: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Columns `(3V, K)` of unit norm and `(K,)` s.d.s to `(K, V, 3)` offsets at one s.d., float32.

    One component at a time: the files are large, and a second copy in double would be larger.
    """
    n_components = columns.shape[1]
    basis = np.empty((n_components, columns.shape[0] // 3, 3), np.float32)
    for k in range(n_components):
        basis[k] = columns[:, k].reshape(-1, 3) * sd[k]
    return basis


def known_landmarks(model: str, vertex_numbers: np.ndarray) -> dict[str, np.ndarray]:
    """Landmark vertices from the tables, as rows of a mesh that may hold only part of the model.

    Args:
        model: Column of the landmark tables, such as `"ict"`.
        vertex_numbers: `(V,)` ascending, the number in the model's own count of each mesh vertex.

    Returns:
        Scheme name to `(L,)` mesh vertices; only schemes of which the mesh has every vertex.
    """
    found = {}
    for name in SCHEMES:
        vertices = load_vertices(name).vertices.get(model)
        if vertices is None or not np.isin(vertices, vertex_numbers).all():
            continue
        found[name] = np.searchsorted(vertex_numbers, vertices)
    return found
