"""Last step of the BFM track: the paper's table next to ours, and figures."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from deepmds_keras.files import read_arrays
from deepmds_keras.geometry.views import PROJECTIONS
from experiments.figures.curves import learning_curves
from experiments.figures.errors import error_per_pose
from experiments.inputs import Faces, load_faces
from experiments.recipes import mobileface_file
from experiments.records import new_results
from experiments.run import Run
from experiments.scoring.numbers import turned
from experiments.scoring.parameters import write_parameter_table
from experiments.scoring.scores import metrics_by_seed
from experiments.tracks.results import Evaluation, load_histories, median_face, predicted_shapes

# Rows that the authors' script scores differently from all other methods.
ZHAO = ("zhao", "zhao_authors", "zhao_frontal", "zhao_weights")
AS_AUTHORS = "zhao_evaluator"
TRUE_DEPTH = "zhao_true_depth"  # a net that makes no error
_RELEASED_NOTE = (
    "scored as the released evaluator does: the true x and y, joined to the predicted depth of the "
    "face before, rescaled by itself to [0, 1]"
)


def as_released(shapes: dict[str, np.ndarray], truth: np.ndarray) -> dict[str, np.ndarray]:
    """Shapes `(n, L, 3)` that the released evaluator compares with the truth, by method.

    Its script for Zhao's net reads only the depth, and from the previous file. It rescales the
    depth to [0, 1] by itself and joins it to the true x and y, whose depth spans less than half of
    that. It then averages over one face only, which is not done here.

    Returns:
        The same, with Zhao's rows replaced and the true depth added as a row.
    """
    replaced = {method: shapes[method] for method in ZHAO if method in shapes}
    replaced[TRUE_DEPTH] = truth
    for method, shape in replaced.items():
        depth = shape[..., 2:]
        low, high = depth.min(1, keepdims=True), depth.max(1, keepdims=True)
        of_face_before = np.roll((depth - low) / (high - low), 1, axis=0)
        replaced[method] = np.concatenate([truth[..., :2], of_face_before], axis=2)
    return shapes | replaced


def evaluations(run: Run, methods: Sequence[str]) -> list[Evaluation]:
    """Score the methods' predictions, as the run's evaluator does."""
    test = load_faces(run, "test")
    shapes, descriptions = predicted_shapes(run, methods)
    options = {"seeds": metrics_by_seed(run) if run.seeds else None}
    if run.evaluator == "released":
        shapes = as_released(shapes, test.shapes)
        # The authors give the net frontal views: the paper's number belongs to that row.
        options = {"paper_rows": {"zhao": "zhao_frontal"}}
        options["notes"] = dict.fromkeys((*ZHAO, TRUE_DEPTH), _RELEASED_NOTE)
    elif "zhao_frontal" in shapes:  # whose score by that evaluator is what the paper prints
        scored = as_released({"zhao_frontal": shapes["zhao_frontal"]}, test.shapes)
        shapes[AS_AUTHORS] = scored["zhao_frontal"]
        options |= {"paper_rows": {"zhao": AS_AUTHORS}, "notes": {AS_AUTHORS: _RELEASED_NOTE}}
    return [Evaluation(run, run.evaluation, test, shapes, descriptions, **options)]


def draw(evaluation: Evaluation) -> None:
    """Write every figure."""
    run, test, of_images = evaluation.run, evaluation.test, {}
    if "mobileface" in evaluation.scores:
        evaluation.draw_renders("renders")
        of_images["mobileface"] = read_arrays(mobileface_file(run))[1]["history"]
    evaluation.save(learning_curves(load_histories(run), of_images), "learning_curves")
    titles, faces = typical_faces(test, evaluation.scores["deep_mds"].mse)
    evaluation.draw_faces("qualitative", faces, titles)

    poses = pd.DataFrame({"yaw": test.cameras.yaw, "pitch": test.cameras.pitch})
    poses["projection"] = np.array(PROJECTIONS)[test.cameras.projection]
    errors = [poses.assign(method=m, mse=scores.mse) for m, scores in evaluation.drawn.items()]
    errors = pd.concat(errors, ignore_index=True)
    evaluation.save(error_per_pose(errors, evaluation.unit), "error_per_pose")


def typical_faces(test: Faces, mse: np.ndarray) -> tuple[list[str], np.ndarray]:
    """One face for each kind of view: the one whose error is the median of its kind."""
    perspective = test.cameras.projection == PROJECTIONS.index("perspective")
    kinds = {
        f"orthographic\nyaw {turned(yaw)}": ~perspective & (test.cameras.yaw == yaw)
        for yaw in np.unique(test.cameras.yaw[~perspective])
    }
    kinds["perspective"] = perspective
    kinds = {title: np.flatnonzero(members) for title, members in kinds.items() if members.any()}
    faces = [median_face(members, mse) for members in kinds.values()]
    return [*kinds], np.array(faces)


def main(run: Run, *methods: str) -> dict:
    (evaluation,) = evaluations(run, methods)
    evaluation.write()
    folders = [evaluation.folder]
    if run.evaluator == "paper":  # other figures and tables do not depend on the evaluator
        draw(evaluation)
        folders.append(run.experiment_results("parameters"))
        write_parameter_table(new_results(folders[-1]), run, evaluation.metrics)
    return {"methods": [*methods], "results": [str(folder) for folder in folders]}
