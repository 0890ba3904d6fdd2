"""Stage of the FLAME track: what MediaPipe's face mesh makes of the test photos."""

from __future__ import annotations

import time

import numpy as np

from deepmds_keras.detection.mediapipe_landmarks import detect, landmarks51
from experiments.arguments import parse_run
from experiments.inputs import load_crops
from experiments.progress import Bar
from experiments.running import stage
from experiments.tracks.predictions import write_shapes

# By whose list of points: the authors', or the one in which the left brow is where it should be.
_LISTS = {"mediapipe": "authors", "mediapipe_corrected": "corrected"}


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    with stage(run, "mediapipe") as record:
        files = load_crops(run)
        photos = (photo for faces in files.ranges() for photo in files[faces])
        start = time.perf_counter()
        points = detect(Bar(photos, total=len(files), desc="mediapipe", unit="image"))
        milliseconds = 1000 * (time.perf_counter() - start) / len(files)
        found = np.isfinite(points).all((1, 2))
        record |= {"methods": [*_LISTS], "found": int(found.sum()), "images": len(files)}
        for method, which in _LISTS.items():
            described = {"method": method, "ms_per_face": milliseconds}
            write_shapes(run, method, {"shapes": landmarks51(points, which)}, described)
