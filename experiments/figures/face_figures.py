"""Figures of test faces in every experiment: some with each method, and errors by landmark."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from deepmds_keras.landmarks import LandmarkScheme
from experiments.figures.errors import error_per_landmark
from experiments.figures.examples import write_examples
from experiments.figures.qualitative import Photos, qualitative
from experiments.figures.style import save
from experiments.inputs import Faces
from experiments.methods import METHODS
from experiments.scoring.scores import Scores, landmark_errors


def drawn_of(scores: Mapping[str, Scores]) -> dict[str, Scores]:
    """Scores of the methods that figures show, in the order of the tables."""
    return {m.id: scores[m.id] for m in METHODS.values() if m.drawn and m.id in scores}


def draw_faces(
    folder: Path,
    name: str,
    scheme: LandmarkScheme,
    test: Faces,
    frontal: np.ndarray,
    scores: Mapping[str, Scores],
    faces: np.ndarray,
    titles: Sequence[str],
    photos: Photos | None = None,
) -> None:
    """Write some test faces as a figure, and as numbers.

    Args:
        folder: Of the results.
        name: Of the figure.
        scheme: Landmark scheme.
        test: Test faces.
        frontal: `(n, L, 2)` frontal views that `ours` found of all of them.
        scores: Method id to scores on the test faces.
        faces: Numbers of the faces.
        titles: Their names.
        photos: Of these faces, to be drawn in place of their views.
    """
    shown = {method: own for method, own in scores.items() if METHODS[method].pictured}
    figure = qualitative(
        test.views[faces],
        frontal[faces],
        test.shapes[faces],
        {method: own.aligned[faces] for method, own in shown.items()},
        scheme,
        titles,
        {method: own.mse[faces] for method, own in shown.items()},
        photos,
    )
    save(figure, folder / "figures", name)
    write_examples(folder, scheme, test, scores, faces, titles)


def draw_landmark_errors(
    folder: Path,
    scheme: LandmarkScheme,
    test: Faces,
    scores: Mapping[str, Scores],
    track: str,
) -> None:
    """Write the figure of the errors by landmark, some of them as whole faces."""
    errors = landmark_errors(scores)
    maps = [method for method in errors if track in METHODS[method].mapped]
    figure = error_per_landmark(errors, scheme, test.shapes.mean(0), maps)
    save(figure, folder / "figures", "error_per_landmark")
