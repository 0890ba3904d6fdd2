"""Last step of the CelebA experiment: the paper's table next to ours, and figures."""

from collections.abc import Sequence

import numpy as np

from deepmds_keras.files import read_arrays
from deepmds_keras.landmarks import load_scheme
from experiments.datasets.detected_faces import USED
from experiments.datasets.photos import photos
from experiments.figures.ground_truth import fits
from experiments.inputs import Faces
from experiments.run import Run
from experiments.scoring.numbers import turned
from experiments.tracks.results import Evaluation, evaluate_both, median_face, write_results

_YAWS = (-18.0, 0.0, 18.0)  # degrees: a face about each is shown


def evaluations(run: Run, methods: Sequence[str]) -> list[Evaluation]:
    """Score the predictions against the fit to the photos, and the true landmarks if known."""
    return evaluate_both(run, methods, read_arrays(run.work / "photos.npz")[0], "model_fit")


def shown_faces(test: Faces, mse: np.ndarray) -> np.ndarray:
    """The face of median error near each of `_YAWS`."""
    n = max(1, len(mse) // 20)
    near = [np.argsort(np.abs(test.cameras.yaw - yaw))[:n] for yaw in _YAWS]
    return np.array([*dict.fromkeys(median_face(faces, mse) for faces in near)])


def draw(evaluation: Evaluation, true_evaluation: Evaluation | None = None) -> None:
    """Write the figures; if the true landmarks are known, that of the fit shows its errors."""
    run, test = evaluation.run, evaluation.test
    faces = shown_faces(test, evaluation.scores["deep_mds"].mse)
    titles = [f"yaw {turned(yaw)}" for yaw in test.cameras.yaw[faces]]
    evaluation.draw_faces("celeba", faces, titles, photos=True)
    evaluation.draw_renders("photos")

    errors = {} if true_evaluation is None else true_evaluation.scores
    distances = {
        method: np.sqrt((errors[method].distances_mm ** 2).mean(1))
        for method in ("model_fit", "mean_shape")
        if method in errors
    }
    table, _ = read_arrays(run.work / "photos.npz")
    numbers = np.flatnonzero(table["status"] == USED)[faces]
    images = [next(photos(run, range(k, k + 1)))[1] for k in numbers]
    detected, fitted = table["detected"][faces], table["pixels"][faces]
    evaluation.save(fits(images, detected, fitted, load_scheme(run.scheme), distances), "fits")


def main(run: Run, *methods: str) -> dict:
    return write_results(evaluations(run, methods), draw)
