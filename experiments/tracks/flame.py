"""Last step of the FLAME track: the paper's CASIA-3D table next to ours, and figures."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from deepmds_keras.files import read_arrays
from deepmds_keras.landmarks import load_scheme
from experiments.datasets.detected_faces import USED
from experiments.figures.curves import learning_curves
from experiments.figures.errors import Panel, error_lines, mean_errors
from experiments.figures.ground_truth import ground_truth
from experiments.recipes import ringnet_file
from experiments.run import Run
from experiments.scoring.scores import Scores
from experiments.tracks.results import (
    Evaluation,
    evaluate_both,
    load_histories,
    median_face,
    write_results,
)

_SHOWN_FACES = 4


def evaluations(run: Run, methods: Sequence[str]) -> list[Evaluation]:
    """Score the predictions against landmarks found on scans, and the true ones if known."""
    scans, _ = read_arrays(run.work / "scans.npz")
    subjects = scans["name"][scans["status"] == USED].astype("U3")
    fitted = {"model_fit": scans["fitted"]}
    return evaluate_both(run, methods, scans, "scan_landmarks", fitted, subjects)


def draw(evaluation: Evaluation, true_evaluation: Evaluation | None = None) -> None:
    """Write the figures of the methods and of the test set."""
    run, of_images = evaluation.run, {}
    if "ringnet" in evaluation.scores:
        # The other record, of the landmarks' error alone, is in another unit.
        history = read_arrays(ringnet_file(run))[1]["history"]
        of_images["ringnet"] = {"train": history["train"]}
    evaluation.save(learning_curves(load_histories(run), of_images), "learning_curves")

    scans, _ = read_arrays(run.work / "scans.npz")
    conditions = scans["condition"]
    faces = shown_faces(conditions, evaluation.scores)
    titles = [conditions[k].replace("_", " ") for k in faces]
    evaluation.draw_faces("casia", faces, titles, photos=True)
    if len({*conditions}) > 1:
        names = pd.Series(conditions).str.replace("_", " ")
        rows = [
            pd.DataFrame({"method": method, "condition": names, "mse": scores.mse})
            for method, scores in evaluation.drawn.items()
        ]
        means = mean_errors(pd.concat(rows).dropna(), "condition")
        figure = error_lines([Panel(means, "condition")], unit=evaluation.unit)
        evaluation.save(figure, "error_per_expression")
    if "example" in scans:
        names = scans["name"][scans["status"] == USED]
        faces = np.flatnonzero(np.isin(names, scans["example"]))
        figure = ground_truth(scans, faces, *evaluation.photos(faces), load_scheme(run.scheme))
        evaluation.save(figure, "scans")


def shown_faces(conditions: np.ndarray, scores: dict[str, Scores]) -> np.ndarray:
    """A face of median error of `deep_mds` for each of some conditions, and one that is N/A.

    The latter is the one with the least error: elsewhere dlib may have detected only an eye.
    Without known conditions, the faces range from a small error of `deep_mds` to a large one.
    """
    mse = scores["deep_mds"].mse
    names = [*dict.fromkeys(conditions)]
    groups = [np.flatnonzero(conditions == name) for name in names]
    if len(names) == 1:
        groups = np.array_split(np.argsort(mse), min(_SHOWN_FACES, len(mse)))
    faces = [median_face(group, mse) for group in groups]
    missing = [np.flatnonzero(np.isnan(evaluation.mse)) for evaluation in scores.values()]
    missing = next((faces[np.argsort(mse[faces])] for faces in missing if len(faces)), [])
    return np.array([*faces[: _SHOWN_FACES - bool(len(missing))], *missing[:1]])


def main(run: Run, *methods: str) -> dict:
    return write_results(evaluations(run, methods), draw)
