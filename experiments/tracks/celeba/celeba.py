"""Last stage of the CelebA experiment: the paper's table, ours beside it, figures, manifest."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from data_gen.rendering.crops import crop
from data_gen.rendering.renderer import MARGIN
from deepmds_keras.alignment import align
from deepmds_keras.baselines.mean_shape import MeanShape
from deepmds_keras.io.archives import read_arrays
from deepmds_keras.landmarks import load_scheme
from experiments.arguments import parse_run
from experiments.figures.face_figures import draw_faces, draw_landmark_errors, drawn_of
from experiments.figures.fits import FittedPhoto, fits
from experiments.figures.qualitative import Photos
from experiments.figures.renders import renders
from experiments.figures.style import save
from experiments.inputs import USED, Faces, crop_files, load_faces, of_used
from experiments.manifest import records_of, write_manifest
from experiments.run import Run
from experiments.running import stage
from experiments.scoring.scores import Scores, evaluate, load_predictions
from experiments.tracks.celeba.photo_sources import photo_source
from experiments.tracks.results import write_results

_TRUE, _FIT = "true_landmarks", "model_fit"
_YAWS = (-18.0, 0.0, 18.0)  # degrees: a face about each is shown
_PHOTO = 112  # pixels of a side of a photo in a picture
_RENDERS = 24


def shown_faces(test: Faces, mse: np.ndarray) -> tuple[list[str], np.ndarray]:
    """Of the faces turned about as far as each of `_YAWS` the one with the median error."""
    faces, titles = [], []
    for yaw in _YAWS:
        near = np.argsort(np.abs(test.cameras.yaw - yaw))[: max(1, len(mse) // 20)]
        face = near[np.argsort(mse[near])[len(near) // 2]]
        if face in faces:
            continue
        faces.append(face)
        titles.append(f"yaw {test.cameras.yaw[face]:+.0f}°".replace("-", "−"))
    return titles, np.array(faces)


def photos_of(run: Run, photos: dict[str, np.ndarray], faces: np.ndarray) -> list[FittedPhoto]:
    """Photos of some test faces, made or read again, with what was found in them."""
    numbers = np.flatnonzero(photos["status"] == USED)[faces]
    source = photo_source(run)
    found = []
    for number in numbers:
        (photo,) = source.photos(range(number, number + 1))
        truth = photos["truth"][number]
        found.append(
            FittedPhoto(
                image=photo.image,
                detected=photos["detected"][number],
                projected=photos["pixels"][number],
                fitted=photos["landmarks"][number],
                truth=None if np.isnan(truth).any() else truth,
            )
        )
    return found


def draw(
    run: Run,
    test: Faces,
    photos: dict[str, np.ndarray],
    scores: dict[str, Scores],
    frontal: np.ndarray,
    truth: np.ndarray | None,
    folder: Path,
) -> None:
    """Write the figures, and some faces as numbers."""
    figures, scheme = folder / "figures", load_scheme(run.scheme)
    drawn = drawn_of(scores)
    titles, faces = shown_faces(test, scores["ours"].mse)
    shown_photos = photos_of(run, photos, faces)
    squares = [crop(p.image, p.projected, _PHOTO, MARGIN) for p in shown_photos]
    shown = Photos(*map(np.stack, zip(*squares, strict=True)))
    draw_faces(folder, "celeba", scheme, test, frontal, drawn, faces, titles, shown)
    draw_landmark_errors(folder, scheme, test, drawn, run.track)

    distances = None
    if truth is not None:
        fitted = of_used(photos, "landmarks")
        mean = MeanShape().fit(test.views, truth).predict(test.views)
        distances = {
            "fitted to the photo": _root_mean_square(align(fitted, truth) - truth),
            "the mean of all true shapes": _root_mean_square(align(mean, truth) - truth),
        }
    save(fits(shown_photos, scheme, distances), figures, "fits")

    files = crop_files(run, len(test.views))
    first = range(min(_RENDERS, len(test.views)))
    save(renders(files[slice(len(first))], files.landmarks(first), scheme), figures, "photos")


def _root_mean_square(differences: np.ndarray) -> np.ndarray:
    """Of the distances of each face's landmarks: `(n, L, 3)` → `(n,)`."""
    return np.sqrt((differences**2).sum(2).mean(1))


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    with stage(run, "celeba"):
        test, (photos, _) = load_faces(run, "test"), read_arrays(run.work / "photos.npz")
        loaded = load_predictions(run)
        shapes = {method: arrays["shapes"] for method, (arrays, _) in loaded.items()}
        descriptions = {method: described for method, (_, described) in loaded.items()}
        truth, fitted = of_used(photos, "truth"), of_used(photos, "landmarks")
        known = not np.isnan(truth).any()
        here = shapes | {_TRUE: truth} if known else shapes
        folders = [run.experiment_results("celeba")]
        metrics, scores = evaluate(run, test, here, descriptions)
        write_results(run, folders[0], metrics, scores)
        frontal = loaded["ours"][0]["frontal"]
        draw(run, test, photos, scores, frontal, truth if known else None, folders[0])
        if known:
            folders.append(run.experiment_results("celeba-true-landmarks"))
            with_fit = shapes | {_FIT: fitted}
            metrics, scores = evaluate(run, test.against(truth), with_fit, descriptions)
            write_results(run, folders[1], metrics, scores)
        stages = records_of(run, "celeba", own=False)
        for folder in folders:
            write_manifest(run, "reproduce-celeba", stages, folder)
