"""Step of the CelebA experiment: the face model fitted to each photo, for truth and for views.

As in the paper, the fitted shape is both the truth against which methods are measured and, seen
by the camera of the fit, the landmarks that they get.
"""

import functools
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from data_gen.datasets.celeba import find_images
from data_gen.datasets.image_files import read_image
from data_gen.datasets.photos_substitute import PhotosSubstitute
from data_gen.edge_fitting import EdgeFitter
from data_gen.photographs import crop
from data_gen.renderer import MARGIN
from deepmds_keras.baselines.images import IMAGE_SIZE
from deepmds_keras.errors import InputError
from experiments.datasets.detected_faces import find_faces
from experiments.inputs import face_model
from experiments.records import listing, resumable
from experiments.run import Run
from experiments.streams import Stream

_PHOTOS_PER_PIECE = 100


@functools.cache
def _source(run: Run) -> list[Path] | PhotosSubstitute:
    """The first photos of CelebA's test partition, of all if it is not there; or the substitute."""
    folder = run.folder_of("celeba")
    if folder is not None:
        return find_images(folder)[: run.preset.photos]
    return PhotosSubstitute(face_model(run), run.preset.photos, [run.seed, Stream.PHOTOS])


def photos(
    run: Run, numbers: range
) -> Iterator[tuple[str, np.ndarray | InputError, dict[str, np.ndarray]]]:
    """Some of the photos that a run tests on, drawn or read.

    Yields:
        Its file's name; `(H, W, 3)` uint8, or why it cannot be read; and if they are known
        the true landmarks `truth`, `(L, 3)` millimetres in the frame of the face model.

    Raises:
        InputError: The data set is not where it should be, or the model cannot be drawn.
    """
    source = _source(run)
    if isinstance(source, PhotosSubstitute):
        for photo in source.photos(numbers):
            yield photo.name, photo.image, {"truth": photo.landmarks[run.scheme]}
        return
    for path in source[numbers.start : numbers.stop]:
        try:
            yield path.name, read_image(path, ("JPEG", "PNG")), {}
        except InputError as error:
            yield path.name, error, {}


def photos_of_piece(run: Run, piece: int) -> Iterator[tuple]:
    """Photos of one piece, for `find_faces`."""
    return photos(run, _pieces(run)[piece])


def fit_photo(
    run: Run, image: np.ndarray, detected: np.ndarray, truth: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Columns of a photo's row in the table, for `find_faces`."""
    model = face_model(run)
    fit = _fitter(run).fit(detected, image)
    shape = model.at_landmarks(run.scheme).shape(fit.identity)
    pixels, rotation = fit.project(shape), fit.camera.rotation
    square, crop_landmarks = crop(image, pixels, IMAGE_SIZE, MARGIN)
    return truth | {
        "image": square,
        "crop_landmarks": crop_landmarks,
        "detected": detected,
        "landmarks": shape,
        "pixels": pixels,
        # As in training: the position of its origin is part of the fit.
        "view": shape @ rotation[:2].T,
        "rotation": rotation,
    }


def _pieces(run: Run) -> list[range]:
    """Numbers of the photos of each piece."""
    numbers = range(len(_source(run)))
    return [numbers[k : k + _PHOTOS_PER_PIECE] for k in numbers[::_PHOTOS_PER_PIECE]]


@functools.cache
def _fitter(run: Run) -> EdgeFitter:
    return EdgeFitter(face_model(run))


def main(run: Run) -> dict:
    model, folder = face_model(run), run.folder_of("celeba")
    sizes = [len(numbers) for numbers in _pieces(run)]
    pieces = resumable(run.work / "photos", model=model.sha256, celeba=listing(folder))
    name = f"substitute, {model.name}" if folder is None else "CelebA"
    record = {"model_sha256": model.sha256, "source": name}
    return record | find_faces(run, "photo", pieces, sizes, photos_of_piece, fit_photo)
