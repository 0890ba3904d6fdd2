"""Faces and images for the steps, in the paper's unit."""

from __future__ import annotations

import functools
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from data_gen.datasets.dataset import Dataset, load_dataset
from data_gen.datasets.image_files import ImageFiles
from data_gen.models.flame import find_embedding
from data_gen.models.morphable_model import MorphableModel
from data_gen.models.registry import load_model, model_files
from deepmds_keras.baselines.images import IMAGE_SIZE
from deepmds_keras.errors import InputError
from deepmds_keras.files import read_arrays
from deepmds_keras.geometry.units import centre, normalise, unit
from deepmds_keras.geometry.views import Cameras, in_camera_frame
from experiments.records import read_record
from experiments.run import Run

# Photos of the FLAME track: RingNet's size, with room for the whole face.
CROP_SIZE, CROP_MARGIN = 224, 2.0
# Steps that write images, and their checksums into their record, by track and part.
IMAGE_STEPS = {
    ("bfm", "train"): "images",
    ("bfm", "test"): "images",
    ("flame", "test"): "scans",
    ("flame", "rings"): "rings",
    ("celeba", "test"): "photos",
}
# Images that methods are trained on.
TRAINING_IMAGES = {"bfm": "train", "flame": "rings"}


@dataclass(frozen=True, eq=False)
class Faces:
    """Training or test faces as the methods see them.

    Attributes:
        views: `(n, L, 2)` normalised views.
        shapes: `(n, L, 3)` normalised true landmarks.
        unit_mm: `(n,)` millimetres that 1 stands for in `shapes`.
        posed: `(n, L, 3)` normalised view and, in its unit, depth towards the camera: the training
            data of a method that adds depth to the view.
    """

    views: np.ndarray
    shapes: np.ndarray
    unit_mm: np.ndarray
    posed: np.ndarray
    cameras: Cameras

    def __getitem__(self, faces) -> Faces:
        """Some of the faces, by a slice, a mask or their numbers."""
        return Faces(**{name: values[faces] for name, values in vars(self).items()})

    def with_truth(self, landmarks: np.ndarray) -> Faces:
        """The same faces with other landmarks, `(n, L, 3)` millimetres, for their ground truth."""
        return replace(
            self, shapes=np.float32(normalise(landmarks)), unit_mm=unit(landmarks)[1].ravel()
        )


def in_photos(run: Run, dataset: Dataset) -> Dataset:
    """A data set with views placed as the run's track and protocol require.

    Test views of the FLAME track come from photos, which do not show the origin of the face model,
    on which `normalise` depends. The mean of each view's landmarks is therefore moved to the
    origin, in training and in test. In the released protocol they stay where they are, since the
    authors' scripts normalise raw pixels.
    """
    if run.track != "flame" or run.protocol == "released":
        return dataset
    return replace(dataset, views=np.float32(centre(dataset.views)))


def load_faces(run: Run, part: str) -> Faces:
    """Read `"train"` or `"test"` faces of a run.

    Raises:
        InputError: The file is missing or damaged.
    """
    return as_seen(load_dataset(run.work / f"{part}.npz"))


def as_seen(dataset: Dataset) -> Faces:
    """A data set in the paper's unit."""
    low, size = unit(dataset.views)
    depth = in_camera_frame(dataset.landmarks.astype(float), dataset.cameras)[..., 2:] / size
    views = (dataset.views - low) / size
    return Faces(
        views=np.float32(views),
        shapes=np.float32(normalise(dataset.landmarks)),
        unit_mm=unit(dataset.landmarks)[1].ravel(),
        posed=np.float32(np.concatenate([views, depth], axis=-1)),
        cameras=dataset.cameras,
    )


def image_files(run: Run, part: str, n: int | None = None) -> ImageFiles:
    """Where images are, or will be.

    Args:
        part: `"train"` or `"test"` for those faces of the run, or `"rings"` for the people whom
            RingNet is trained on. Images of test faces are squares cut out of photos, except on
            the BFM track.
        n: Number of faces; None takes all such faces.
    """
    if n is None and part == "rings":
        n = run.preset.ring_subjects * run.preset.ring_images
    elif n is None and part == "train":
        n = run.preset.train_images
    elif n is None:
        n = len(load_dataset(run.work / "test.npz"))
    size = CROP_SIZE if (run.track, part) == ("flame", "test") else IMAGE_SIZE
    return ImageFiles(run.work / "images" / part, n, size)


def load_images(run: Run, part: str) -> ImageFiles:
    """Images as their step left them; `part` as for `image_files`.

    Raises:
        InputError: A file is missing or was changed.
    """
    files = image_files(run, part)
    files.check(read_record(run.record_file(IMAGE_STEPS[run.track, part]))["checksums"][part])
    return files


@functools.cache
def face_model(run: Run) -> MorphableModel:
    """The run's face model with the landmarks of its track, read once per process.

    Raises:
        InputError: Its file is missing or damaged, or has no such landmarks.
    """
    return load_model(run.model, run.data, run.scheme).scaled(run.bfm_scale)


def embedding_file(run: Run) -> Path:
    """Landmarks on CoMA's meshes, which are FLAME's: of FLAME itself, or without it any near.

    Raises:
        InputError: There are none.
    """
    near = run.data or run.coma
    with suppress(InputError):
        return model_files("flame", near)[-1]
    return find_embedding(near)


def load_landmark_model(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Mean `(L, 3)` and identity basis times s.d. `(K, L, 3)` of the landmarks, millimetres."""
    arrays, _ = read_arrays(run.work / "landmark_model.npz")
    return arrays["mean"], arrays["identity_basis_times_sd"]
