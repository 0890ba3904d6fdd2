"""Scores of a track's methods against one truth, and the files that every track writes."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from data_gen.models.registry import TITLES
from data_gen.photographs import crop
from deepmds_keras.files import read_arrays
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.weights import checkpoint_files
from experiments.figures import style
from experiments.figures.errors import error_per_landmark
from experiments.figures.qualitative import qualitative, renders
from experiments.figures.summary import summary
from experiments.inputs import Faces, image_files, load_faces
from experiments.methods import CONSTANT, DEEP_MDS, METHODS, constant_answers, notes
from experiments.records import new_results, write_csv, write_text
from experiments.run import Run
from experiments.scoring.published import unit_of
from experiments.scoring.scores import (
    Scores,
    evaluate,
    landmark_errors,
    load_prediction,
    load_predictions,
    per_face,
)
from experiments.scoring.tables import write_tables
from experiments.scoring.typesetting import paper_layout

# Of photos in a picture: pixels of a side, and the side in sizes of the landmarks' box.
_PHOTO, _MARGIN = 112, 1.4
_RENDERS = 12


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Methods compared with one truth.

    Attributes:
        name: Name of the folder of results.
        test: Test faces, with that truth.
        shapes, descriptions: Predictions by method, as for `scores.evaluate`.
        notes: On methods, in addition to those of their rows.
        paper_rows, seeds: As for `tables.summarise`.
        subjects: `(n,)` of the test faces, where a subject may have several.
    """

    run: Run
    name: str
    test: Faces
    shapes: dict[str, np.ndarray]
    descriptions: dict[str, dict]
    notes: Mapping[str, str] = field(default_factory=dict)
    paper_rows: Mapping[str, str] = field(default_factory=dict)
    seeds: pd.DataFrame | None = None
    subjects: np.ndarray | None = None

    @cached_property
    def _evaluated(self) -> tuple[pd.DataFrame, dict[str, Scores]]:
        return evaluate(self.run, self.test, self.shapes, self.descriptions)

    @property
    def metrics(self) -> pd.DataFrame:
        """The content of `metrics.csv`."""
        return self._evaluated[0]

    @property
    def scores(self) -> dict[str, Scores]:
        """Scores of all test faces by method."""
        return self._evaluated[1]

    @property
    def drawn(self) -> dict[str, Scores]:
        """Scores of the methods that figures show, in the order of the tables."""
        methods = [m for m, method in METHODS.items() if method.drawn and m in self.scores]
        return {method: self.scores[method] for method in methods}

    @property
    def folder(self) -> Path:
        """Folder of results."""
        return self.run.experiment_results(self.name)

    @property
    def unit(self) -> float:
        """Power of ten in which its table and figures have errors, that of the paper's table."""
        return unit_of(self.run.track, "mse")

    @cached_property
    def _new(self) -> Path:
        return new_results(self.folder)

    @property
    def table_options(self) -> dict:
        """Options of `tables.summarise`."""
        detected = {method: scores.detected for method, scores in self.scores.items()}
        return {
            "experiment": self.run.track,
            "subset_size": self.run.preset.subset_size,
            "n_landmarks": len(load_scheme(self.run.scheme)),
            "notes": notes(self.run, detected) | dict(self.notes),
            "paper_rows": self.paper_rows,
            "seeds": self.seeds,
        }

    def write(self) -> None:
        """Write `metrics.csv`, the tables and their figure."""
        write_csv(self._new / "metrics.csv", self.metrics)
        values = per_face(self.scores, self.subjects)
        over = "faces" if self.subjects is None else "subjects"
        options = self.table_options | {"per_face": values, "over_all": over}
        table = write_tables(self._new, self.metrics, **options)
        layout = paper_layout(table, self.run.track, TITLES[self.run.model], self.paper_rows)
        write_text(self._new / "table_paper.tex", layout)
        self.save(summary(table, self.table_options["n_landmarks"], self.unit), "summary")

    def save(self, figure: Figure, name: str) -> None:
        """Write a figure."""
        style.save(figure, self._new / "figures", name, self.run.preset.caution)

    def draw_faces(
        self, name: str, faces: np.ndarray, titles: Sequence[str], photos: bool = False
    ) -> None:
        """Write the figures of some faces with each method, and of the errors by landmark.

        Methods that are not `pictured` have a separate figure, whose name ends with `_others`.

        Args:
            name: Name of the first figure.
            faces: Numbers of test faces; `deep_mds` is among the methods.
            titles: Their names.
            photos: Whether the views were detected in photos, to be drawn in their place.
        """
        frontal = load_prediction(self.run, "deep_mds")[0]["frontal"]
        seen = self.photos(faces) if photos else None
        views, scheme = self.test.views, load_scheme(self.run.scheme)
        for pictured, suffix in ((True, ""), (False, "_others")):
            scores = {m: s for m, s in self.drawn.items() if METHODS[m].pictured == pictured}
            if scores:
                figure = qualitative(
                    views, frontal, scores, faces, titles, scheme, seen, unit=self.unit
                )
                self.save(figure, f"{name}{suffix}")
        errors = landmark_errors(self.drawn)
        maps = [method for method in errors if self.run.track in METHODS[method].mapped]
        figure = error_per_landmark(errors, scheme, self.test.shapes.mean(0), maps)
        self.save(figure, "error_per_landmark")

    def photos(self, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Squares `(n, 112, 112, 3)` around some test faces, and the landmarks in their pixels."""
        files = image_files(self.run, "test", len(self.test.views))
        return face_squares(files[faces], files.landmarks()[faces], _PHOTO, _MARGIN)

    def draw_renders(self, name: str) -> None:
        """Write the figure of the first images of test faces."""
        files, first = image_files(self.run, "test", len(self.test.views)), slice(_RENDERS)
        figure = renders(files[first], files.landmarks()[first], load_scheme(self.run.scheme))
        self.save(figure, name)


def median_face(faces: np.ndarray, mse: np.ndarray) -> int:
    """The face with the median error, among some faces given by number."""
    return faces[np.argsort(mse[faces])[len(faces) // 2]]


def face_squares(
    images: Iterable[np.ndarray], landmarks: Iterable[np.ndarray], size: int, margin: float
) -> tuple[np.ndarray, np.ndarray]:
    """Squares around faces, `(n, size, size, 3)`, and the landmarks in their pixels."""
    pairs = zip(images, landmarks, strict=True)
    squares, points = zip(*(crop(*pair, size, margin) for pair in pairs), strict=True)
    return np.stack(squares), np.stack(points)


def predicted_shapes(
    run: Run, methods: Iterable[str]
) -> tuple[dict[str, np.ndarray], dict[str, dict]]:
    """Predictions `(n, L, 3)` by method, and their descriptions; those from images come last."""
    order = sorted(methods, key=lambda method: METHODS[method].switch or "")
    loaded = load_predictions(run, order)
    shapes = {method: arrays["shapes"] for method, (arrays, _) in loaded.items()}
    if "deep_mds" in shapes:
        shapes[CONSTANT] = constant_answers(shapes["deep_mds"])
    return shapes, {method: described for method, (_, described) in loaded.items()}


def evaluate_both(
    run: Run,
    methods: Iterable[str],
    table: Mapping[str, np.ndarray],
    row: str,
    references: Mapping[str, np.ndarray] = {},
    subjects: np.ndarray | None = None,
) -> list[Evaluation]:
    """Score predictions against landmarks located in scans or photos, and true ones if known.

    Args:
        table: Table of the test faces, as from `detected_faces.find_faces`.
        row: Id of the located landmarks, in the table against the true ones.
        references: Shapes `(n, L, 3)` of further rows, by id.
        subjects: As for `Evaluation`.
    """
    test = load_faces(run, "test")
    shapes, descriptions = predicted_shapes(run, methods)
    shapes |= references
    is_licensed = "ringnet_licensed" in shapes  # whose row the paper's is compared with
    paper_rows = {"ringnet": "ringnet_licensed"} if is_licensed else {}
    options = {"paper_rows": paper_rows, "subjects": subjects}
    if "truth" not in table:
        return [Evaluation(run, run.track, test, shapes, descriptions, **options)]
    truth, landmarks = {"true_landmarks": table["truth"]}, {row: table["landmarks"]}
    true_test, name = test.with_truth(table["truth"]), f"{run.track}-true-landmarks"
    return [
        Evaluation(run, run.track, test, shapes | truth, descriptions, **options),
        Evaluation(run, name, true_test, shapes | landmarks, descriptions, **options),
    ]


def write_results(evaluations: Sequence[Evaluation], draw: Callable[..., None]) -> dict:
    """Write tables of evaluations, and by `draw(*evaluations)` figures; return what to record."""
    for evaluation in evaluations:
        evaluation.write()
    draw(*evaluations)
    folders = [str(evaluation.folder) for evaluation in evaluations]
    return {"methods": [*evaluations[0].descriptions], "results": folders}


def load_histories(run: Run) -> dict[str, dict[str, dict]]:
    """Losses of `DEEP_MDS` by method, network and epoch, from the files of the networks."""
    return {
        method: {
            network: read_arrays(path)[1]["history"]
            for network, path in checkpoint_files(run.networks, *settings).items()
        }
        for method, settings in DEEP_MDS.items()
    }
