"""The test photos of the CelebA experiment, of the data set or of what stands in for it."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_gen.datasets import celeba
from data_gen.datasets.photos_standin import PhotosStandin
from data_gen.models.registry import load_model
from deepmds_keras.io.errors import InputError
from experiments.run import Run
from experiments.streams import Stream


@dataclass(frozen=True, eq=False)
class PhotoSample:
    """One photo.

    Attributes:
        name: Of its file.
        image: `(H, W, 3)` uint8, or why it cannot be read.
        truth: `(L, 3)` true landmarks, millimetres, frame of the face model; None of real photos.
        pixels: `(L, 2)` where they are, x right and y down; None of real photos.
    """

    name: str
    image: np.ndarray | InputError
    truth: np.ndarray | None = None
    pixels: np.ndarray | None = None


class Celeba:
    """The first photos of CelebA's test partition, or of all if the partition is not there."""

    source = "CelebA"

    def __init__(self, folder: Path, n: int):
        self._images = celeba.find_images(folder)[:n]

    def __len__(self) -> int:
        return len(self._images)

    def photos(self, numbers: range) -> Iterator[PhotoSample]:
        for number in numbers:
            record = self._images[number]
            try:
                yield PhotoSample(record.name, celeba.load_image(record))
            except InputError as error:
                yield PhotoSample(record.name, error)


class Standin:
    """Photos of random faces of the run's own model."""

    def __init__(self, run: Run):
        model = load_model(run.model, run.data, run.scheme)
        self._photos = PhotosStandin(model, run.preset.photos, [run.seed, Stream.PHOTOS])
        self._scheme = run.scheme
        self.source = f"stand-in, {model.name}"

    def __len__(self) -> int:
        return len(self._photos)

    def photos(self, numbers: range) -> Iterator[PhotoSample]:
        for photo in self._photos.photos(numbers):
            truth, pixels = photo.landmarks[self._scheme], photo.pixels[self._scheme]
            yield PhotoSample(photo.name, photo.image, truth, pixels)


@functools.cache
def photo_source(run: Run) -> Celeba | Standin:
    """Photos that a run tests on.

    Raises:
        InputError: The data set is not where it should be, or the model cannot be drawn.
    """
    return Standin(run) if run.celeba is None else Celeba(Path(run.celeba), run.preset.photos)
