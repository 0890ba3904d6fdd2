"""Meshes and clouds of points, as CoMA and CASIA-3D have them."""

from __future__ import annotations

import numpy as np


def vrml(points):
    rows = ",\n".join(" ".join(map(repr, row)) for row in points.tolist())
    return f"#VRML V2.0 utf8\nShape {{ coord Coordinate {{ point [ {rows} ] }} }}\n"


def asc(points):
    return "\n".join(" ".join(map(repr, row)) for row in points.tolist())


def write_ply(file, vertices, triangles, text=False, byte_order="<", faces="vertex_indices"):
    number = {"f4": "float", "f8": "double"}[vertices.dtype.str[1:]]
    kind = "ascii" if text else {"<": "binary_little_endian", ">": "binary_big_endian"}[byte_order]
    header = [
        *("ply", f"format {kind} 1.0", f"element vertex {len(vertices)}"),
        *(f"property {number} {axis}" for axis in "xyz"),
        *(f"element face {len(triangles)}", f"property list uchar int {faces}", "end_header"),
    ]
    corners = len(triangles[0])
    if text:
        rows = [" ".join(map(repr, map(float, row))) for row in vertices]
        rows += [" ".join(map(str, (corners, *row))) for row in triangles]
        body = "\n".join([*rows, ""]).encode()
    else:
        rows = np.empty(len(triangles), [("n", "u1"), ("v", f"{byte_order}i4", (corners,))])
        rows["n"], rows["v"] = corners, triangles
        body = vertices.astype(vertices.dtype.newbyteorder(byte_order)).tobytes() + rows.tobytes()
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes("\n".join([*header, ""]).encode() + body)
    return file
