"""Some test faces with what every method makes of them, to be turned about in the report."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from deepmds_keras.landmarks import LandmarkScheme
from experiments.inputs import Faces
from experiments.records import write_text
from experiments.scoring.scores import Scores

EXAMPLES = "examples.json"
_DIGITS = 4  # of shapes about one unit wide, which is 200 mm: 0.02 mm


def write_examples(
    folder: Path,
    scheme: LandmarkScheme,
    test: Faces,
    scores: Mapping[str, Scores],
    faces: Sequence[int],
    titles: Sequence[str],
) -> None:
    """Write `examples.json`: a scheme, its lines, and faces as they were seen and found.

    Of each face it holds the title, the normalised view (y up), the true shape, the millimetres
    that 1 stands for in shapes, and of each method the shape aligned to the truth and its mean
    squared error; null where a method did not find the face.

    Args:
        folder: Of the results.
        scheme: Landmark scheme.
        test: Test faces.
        scores: Method id to scores on the test faces.
        faces: Numbers of the test faces to write.
        titles: Their names, as in the qualitative figure.
    """
    written = [
        {
            "title": ", ".join(name.split("\n")),
            "unit_mm": _number(test.unit_mm[face]),
            "view": _rounded(test.views[face]),
            "truth": _rounded(test.shapes[face]),
            "shapes": {method: _rounded(own.aligned[face]) for method, own in scores.items()},
            "mse": {method: _number(own.mse[face]) for method, own in scores.items()},
        }
        for face, name in zip(faces, titles, strict=True)
    ]
    made = {"scheme": scheme.name, "polylines": scheme.polylines, "faces": written}
    text = json.dumps(made, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    write_text(folder / EXAMPLES, text + "\n")


def _rounded(points: np.ndarray) -> list | None:
    # In double precision: a rounded single has all its digits again.
    return None if np.isnan(points).any() else points.astype(float).round(_DIGITS).tolist()


def _number(value: float) -> float | None:
    return None if np.isnan(value) else float(f"{value:.4g}")
