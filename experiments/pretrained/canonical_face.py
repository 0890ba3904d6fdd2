"""MediaPipe's canonical face, a third mean face beside those of the open models.

Its nose is as deep as those of real people: the point above the tip (iBUG's landmark 30) lies 0.27
of the distance between the outer corners of the eyes in front of the mean landmark, on the open
head 0.14, on ICT-FaceKit 0.22, each aligned to the open head by a similarity.
"""

from pathlib import Path

import numpy as np

from deepmds_keras.files import read_table, write_bytes
from deepmds_keras.geometry.alignment import align
from deepmds_keras.landmarks import FOLDER, convert

CANONICAL = Path(__file__).with_name("canonical_face.csv")
_SCHEME = "ibug51"
_NOTICE = """\
# The inner 51 iBUG landmarks of MediaPipe's canonical face, canonical_face_model.obj of
# github.com/google-ai-edge/mediapipe, by mediapipe_ibug68.csv, mm. Written by write_canonical_face.
# Copyright The MediaPipe Authors. Licensed under the Apache License, Version 2.0
# (www.apache.org/licenses/LICENSE-2.0). Changed: 51 of 468 points, centimetres to millimetres.
"""
_MM = 10  # the file has centimetres
# How far the displacement of a landmark reaches to others, and the share of its variance that is
# its own: without that, different displacements of neighbours would grow beyond them.
_REACH_MM, _OWN = 30.0, 0.1


def read_canonical_face() -> np.ndarray:
    """`(51, 3)` millimetres, +x to the subject's left, +y up, +z out of the face."""
    return np.array([[row[axis] for axis in "xyz"] for row in read_table(CANONICAL)], float)


def write_canonical_face(obj: str | Path, path: str | Path = CANONICAL) -> None:
    """Write the table from MediaPipe's file."""
    lines = [line.split()[1:] for line in Path(obj).read_text().splitlines() if line[:2] == "v "]
    points = np.array(lines, float)
    rows = read_table(FOLDER / "mediapipe_ibug68.csv")
    face = np.round(_MM * points[[int(row["number"]) for row in rows]], 3)
    numbered = zip((row["ibug68"] for row in rows), *face.T, strict=True)
    text = "\n".join(f"{number},{x:g},{y:g},{z:g}" for number, x, y, z in numbered)
    write_bytes(Path(path), f"{_NOTICE}ibug68,x,y,z\n{text}\n".encode())


def canonical_mean(mean: np.ndarray, scheme: str) -> np.ndarray:
    """The canonical face in the frame and size of another mean face `(L, 3)` of a scheme, mm.

    Landmarks that it lacks are those of the other face, displaced as their neighbours are.
    """
    canonical = convert(read_canonical_face(), _SCHEME, scheme, missing="nan")
    known = np.isfinite(canonical).all(1)
    moved = align(canonical[known], mean[known], reflection=False) - mean[known]
    squares = ((mean[:, None] - mean[known]) ** 2).sum(2)
    kernel = np.exp(-squares / (2 * _REACH_MM**2))
    carried = kernel @ np.linalg.solve(kernel[known] + _OWN * np.eye(known.sum()), moved)
    carried[known] = moved
    return mean + carried
