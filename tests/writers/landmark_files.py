"""The same landmarks in every layout that is read."""

from __future__ import annotations

import json

import numpy as np

FACES = np.random.default_rng(0).uniform(1, 500, (3, 68, 2))


ONE = FACES[:1]


DEPTH = np.full((3, 68, 1), 7.0)


def table(rows, header=None, separator=","):
    lines = [separator.join(str(cell) for cell in row) for row in rows]
    return "\n".join([*([header] if header else []), *lines]) + "\n"


def long_rows(faces=FACES):
    return [(f"face {i}", j + 18, *point) for i, f in enumerate(faces) for j, point in enumerate(f)]


def pts(points):
    return f"version: 1\nn_points:  {len(points)}\n{{\n{table(points, separator=' ')}}}\n"


def written(folder, name, content):
    path = folder / name
    if isinstance(content, np.ndarray):
        np.save(path, content)
    else:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


LAYOUTS = {
    "columns": ("f.csv", table(ONE[0], "x,y"), ONE),
    "comments, empty lines": ("f.csv", f'# a, "b" c\n\n{table(ONE[0], "x,y")}\n\n', ONE),
    "capitals, Windows, BOM": (
        "F.CSV",
        b"\xef\xbb\xbf" + table(ONE[0], "X , Y").replace("\n", "\r\n").encode(),
        ONE,
    ),
    "many faces": ("f.csv", table(long_rows(), "face,number,x,y"), FACES),
    "beside the shape": (
        "f.csv",
        table([(1, 2, 3, *point) for point in ONE[0]], "x,y,z,image_x,image_y"),
        ONE,
    ),
    "array": ("f.npy", FACES, FACES),
    "array of one": ("f.npy", ONE[0], ONE),
    "array with depth": ("f.npy", np.dstack([FACES, DEPTH]), FACES),
    "array of other bytes": ("f.npy", np.asfortranarray(FACES.astype(">f8")), FACES),
    "points of 300-W": ("f.pts", pts(ONE[0] + 0.5), ONE),
    "JSON": ("f.json", json.dumps(ONE[0].tolist()), ONE),
    "JSON of faces": ("f.json", json.dumps(FACES.tolist()), FACES),
    "JSON with a key": ("f.json", json.dumps({"landmarks": ONE[0].tolist()}), ONE),
    "JSON of records": (
        "f.json",
        json.dumps({"faces": [{"landmarks": f.tolist(), "name": "a"} for f in FACES]}),
        FACES,
    ),
}
