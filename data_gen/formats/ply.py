"""Triangle meshes in PLY files.

Read here and not by a library: the strict one (plyfile) is under the GPL, which this project is
not, and trimesh takes meshes that are cut short for whole.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from deepmds_keras.errors import InputError, brief

_BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2"},
    **{"uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
_LISTS = ("vertex_indices", "vertex_index")
_LONGEST_HEADER = 1 << 16


@np.errstate(invalid="ignore")  # casts of NaN, which is refused
def read_ply(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a mesh, binary or text.

    Args:
        path: The file.

    Returns:
        `(V, 3)` float64 vertices in the file's unit and `(T, 3)` int triangles, 0-based.

    Raises:
        InputError: The file is missing, damaged or no PLY, or its faces are no triangles.
    """
    path = Path(path)
    try:
        arrays = _read(path.read_bytes())
        vertices = np.stack([arrays["vertex"][axis] for axis in "xyz"], axis=1)
        face = arrays["face"]
        name = next((name for name in _LISTS if name in face.dtype.names), _LISTS[0])
        counts, corners = face[f"{name}/n"], face[name]
    except OSError as error:
        raise InputError(f"{path}: must be a PLY mesh. Received: {error.strerror}.") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (KeyError, ValueError) as error:
        raise InputError(
            f"{path}: must be a PLY mesh of vertices x, y, z and faces {_LISTS[0]}. "
            f"Received one without {brief(error)}."
        ) from None
    vertices = vertices.astype(float)
    if not len(vertices) or not np.isfinite(vertices).all():
        raise InputError(f"{path}: vertices must be finite. Received none, or NaN or infinity.")
    if not len(corners) or (counts != 3).any():
        raise InputError(f"{path}: faces must be triangles. Received none, or other polygons.")
    corners = corners.astype(int)
    if not 0 <= corners.min() <= corners.max() < len(vertices):
        raise InputError(
            f"{path}: faces must number {len(vertices)} vertices from 0. "
            f"Received {corners.min()} to {corners.max()}."
        )
    return vertices, corners


def _read(content: bytes) -> dict[str, np.ndarray]:
    """The elements of a file as structured arrays; lists are read as if of three."""
    byte_order, elements, start = _read_header(content)
    if byte_order == "":
        return _read_text(content[start:], elements)
    arrays = {}
    for name, n, properties in elements:
        row = np.dtype([(*word, *shape) for word, shape in _columns(properties, byte_order)])
        if n * row.itemsize > len(content) - start:
            raise _too_short(name, n)
        arrays[name] = np.frombuffer(content, row, n, start)
        start += n * row.itemsize
    return arrays


def _read_text(body: bytes, elements: list) -> dict[str, np.ndarray]:
    try:
        numbers = np.array(body.split(), float)
    except ValueError as error:
        raise InputError(f"must hold numbers after its header. Received: {brief(error)}.") from None
    arrays, start = {}, 0
    for name, n, properties in elements:
        columns = _columns(properties, "")
        width = sum(3 if shape else 1 for _, shape in columns)
        if n * width > len(numbers) - start:
            raise _too_short(name, n)
        table = numbers[start : start + n * width].reshape(n, width)
        row = np.dtype([(label, float, *shape) for (label, _), shape in columns])
        arrays[name] = np.ascontiguousarray(table).view(row)[:, 0]
        start += n * width
    return arrays


def _read_header(content: bytes) -> tuple[str, list, int]:
    """Byte order, elements as name, number and properties, and where the header ends."""
    head = content[:_LONGEST_HEADER]
    line_end = b"\r\n" if head[3:5] == b"\r\n" else head[3:4]
    lines = (
        head.split(line_end) if head[:3] == b"ply" and line_end in (b"\n", b"\r", b"\r\n") else []
    )
    if b"end_header" not in lines:
        raise InputError(
            f"must be a PLY file. Received {len(content)} bytes that begin {head[:8]!r}."
        )
    lines = lines[: lines.index(b"end_header") + 1]
    byte_order, elements = None, []
    for line in lines[1:-1]:
        match line.decode("latin1").split():
            case ["format", kind, "1.0"] if kind in _BYTE_ORDERS:
                byte_order = _BYTE_ORDERS[kind]
            case ["element", name, n] if n.isdecimal():
                elements.append((name, int(n), []))
            case ["property", "list", count, item, name] if elements and {count, item} <= {*_TYPES}:
                elements[-1][2].append((name, _TYPES[item], _TYPES[count]))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1][2].append((name, _TYPES[kind], None))
            case ["comment" | "obj_info", *_] | []:
                pass
            case _:
                raise InputError(f"must have a PLY header. Received the line {brief(line)} in it.")
    if byte_order is None:
        raise InputError("must be a PLY file of format 1.0. Received a header without.")
    return byte_order, elements, sum(map(len, lines)) + len(lines) * len(line_end)


def _columns(properties: list, byte_order: str) -> list:
    """Label and type of each number of a row, and `(3,)` for the items of a list."""
    columns = []
    for name, kind, count in properties:
        if count is not None:
            columns.append(((f"{name}/n", byte_order + count), ()))
        columns.append(((name, byte_order + kind), () if count is None else ((3,),)))
    return columns


def _too_short(name: str, n: int) -> InputError:
    return InputError(
        f"must be a PLY file that holds what it announces. Received less than {n} of {name}."
    )
