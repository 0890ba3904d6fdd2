"""Meshes and points of scans: PLY, VRML, and text of bare coordinates.

PLY is read here and not by a library: the strict one (plyfile) is under the GPL, which this project
is not, and trimesh takes meshes that are cut short for whole.
"""

import re
from pathlib import Path

import numpy as np

from data_gen.models.mesh import check_triangles
from deepmds_keras.errors import InputError, brief

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "<i2", "ushort": "<u2", "int": "<i4", "uint": "<u4"},
    **{"float": "<f4", "double": "<f8", "int8": "i1", "uint8": "u1", "int16": "<i2"},
    **{"uint16": "<u2", "int32": "<i4", "uint32": "<u4", "float32": "<f4", "float64": "<f8"},
}
_PLY_HEADER = re.compile(
    rb"ply\s+format binary_little_endian 1.0\s(.{,65536}?)end_header\r?\n", re.S
)
# Strings go first, since they may hold a "#". The mark of a comment stands apart: "1.#QNAN" is how
# some writers spell NaN, and cutting it to "1." would hide that.
_STRING = re.compile(rb'"[^"\r\n]*"')
_COMMENT = re.compile(rb"#(?<![^\s,\[\]{}]#)[^\r\n]*")
# Other blocks of points: a texture's are in its image; with a letter before it is another word.
_POINTS = re.compile(rb"(texturecoordinate2?\s*\{\s*|\w)?point\s*\[([^\[\]]*)(\]?)")


def read_ply(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """`(V, 3)` vertices in the file's unit and `(T, 3)` triangles, 0-based, of a binary PLY file.

    Raises:
        InputError: The file is missing, damaged or no little-endian PLY, or its faces are no
            triangles.
    """
    content = _read(path)
    try:
        arrays = _ply_elements(content)
        vertices = np.stack([arrays["vertex"][axis] for axis in "xyz"], axis=1).astype(float)
        face = arrays["face"]
        name = "vertex_index" if "vertex_index" in face.dtype.names else "vertex_indices"
        if not len(face) or (face[f"{name}/n"] != 3).any():
            raise InputError("faces must be triangles. Received none, or other polygons.")
        check_triangles(face[name], len(vertices))
    except (LookupError, ValueError) as error:
        problem = error if isinstance(error, InputError) else f"must be a mesh: {brief(error)}."
        raise InputError(f"{path}: {problem}") from None
    if not np.isfinite(vertices).all():
        raise InputError(f"{path}: vertices must be finite. Received NaN or infinity.")
    return vertices, face[name].astype(int)


def _ply_elements(content: bytes) -> dict[str, np.ndarray]:
    """The elements of a file as structured arrays; lists are read as if of three."""
    header = _PLY_HEADER.match(content)
    if header is None:
        raise InputError(
            f"must be a PLY file, binary_little_endian. It begins with {content[:20]!r}."
        )
    elements, arrays, start = [], {}, header.end()
    for line in header[1].decode("latin1").splitlines():
        match line.split():
            case ["element", name, n]:
                elements.append((name, int(n), []))
            case ["property", "list", count, item, name]:
                elements[-1][2].append((f"{name}/n", _TYPES[count]))
                elements[-1][2].append((name, _TYPES[item], (3,)))
            case ["property", kind, name]:
                elements[-1][2].append((name, _TYPES[kind]))
    for name, n, properties in elements:
        row = np.dtype(properties)
        if not 0 <= n * row.itemsize <= len(content) - start:
            raise InputError(f"must be a complete PLY file. Received fewer than {n} of {name}.")
        arrays[name] = np.frombuffer(content, row, n, start)
        start += n * row.itemsize
    return arrays


def read_vrml_points(path: str | Path) -> np.ndarray:
    """`(n, 3)` points of a VRML 1 or 2 text, of the largest block `Coordinate { point [ … ] }`.

    Commas, line ends, comments and upper or lower case do not matter. Transformations around the
    shape are not applied: the points are as the file lists them.

    Raises:
        InputError: The file cannot be read, has no such block or one without end, or a block does
            not hold three finite numbers per point.
    """
    content = _read(path)
    text = _COMMENT.sub(b" ", _STRING.sub(b" ", content.lower()))
    blocks = [(numbers, end) for other, numbers, end in _POINTS.findall(text) if not other]
    if not blocks:
        raise InputError(
            f"{path}: must be a VRML text with a block Coordinate {{ point [ … ] }}. "
            f"Received none in a file that begins with {content[:16]!r}."
        )
    if not all(end for _, end in blocks):
        raise InputError(f"{path}: must end its block 'point [' by ']'. Received none.")
    clouds = [_points(path, numbers.replace(b",", b" ").split()) for numbers, _ in blocks]
    return max(clouds, key=len)


def read_asc_points(path: str | Path) -> np.ndarray:
    """`(n, 3)` points of a text of bare lines "x y z"; empty lines and `#` comments are skipped.

    Raises:
        InputError: The file cannot be read, or a line is not three finite numbers.
    """
    text = _COMMENT.sub(b" ", _read(path)).replace(b",", b" ")
    rows = [words for line in text.splitlines() if (words := line.split())]
    if other := {*map(len, rows)} - {3}:
        raise InputError(f"{path}: must hold three numbers per line. Received {min(other)}.")
    return _points(path, [word for row in rows for word in row])


def _read(path: str | Path) -> bytes:
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: must be a readable file. Received {error}.") from None


def _points(path: str | Path, words: list[bytes]) -> np.ndarray:
    try:
        numbers = np.fromiter(map(float, words), float)
    except ValueError as error:
        raise InputError(f"{path}: points must be numbers. Received: {brief(error, 80)}.") from None
    if not len(numbers) or len(numbers) % 3:
        raise InputError(
            f"{path}: must hold three numbers per point. Received {len(numbers)} in all."
        )
    if not np.isfinite(numbers).all():
        raise InputError(f"{path}: points must be finite. Received NaN or infinity.")
    return numbers.reshape(-1, 3)
