"""Faces and images as the stages read them, in the paper's unit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from data_gen.datasets.dataset import Dataset, load_dataset
from data_gen.datasets.image_files import ImageFiles
from data_gen.views.projections import Cameras, in_camera_frame
from deepmds_keras.io.archives import read_arrays
from deepmds_keras.io.errors import InputError
from deepmds_keras.normalisation import centre, normalise, unit
from deepmds_keras.photos import IMAGE_SIZE
from experiments.records import load_record
from experiments.run import Run

USED = "used"  # status of a scan, or photo, that gave a test face
_CENTRED = "centred"
# Of the photos of the FLAME track: the size that RingNet takes, about all of the face.
CROP_SIZE, CROP_MARGIN = 224, 2.0


@dataclass(frozen=True, eq=False)
class Faces:
    """Training or test faces as the methods see them.

    Attributes:
        views: `(n, L, 2)` normalised views.
        shapes: `(n, L, 3)` normalised true landmarks.
        unit_mm: `(n,)` millimetres that 1 stands for in `shapes`.
        posed: `(n, L, 3)` normalised view and, in its unit, depth towards the camera: what a
            method that adds a depth to the view is trained on.
        cameras: Pose and projection of each face.
    """

    views: np.ndarray
    shapes: np.ndarray
    unit_mm: np.ndarray
    posed: np.ndarray
    cameras: Cameras

    def __getitem__(self, faces) -> Faces:
        """Some of the faces, by a slice, a mask or their numbers."""
        return Faces(**{name: own[faces] for name, own in vars(self).items()})

    def against(self, landmarks: np.ndarray) -> Faces:
        """The same faces with other landmarks, `(n, L, 3)` millimetres, for their ground truth."""
        return replace(
            self, shapes=np.float32(normalise(landmarks)), unit_mm=unit(landmarks)[1].ravel()
        )


def in_photos(run: Run, dataset: Dataset) -> Dataset:
    """A data set of the FLAME track with views as the run's protocol places them.

    Test views are of photos, which do not show where the origin of the face model is, and
    `normalise` depends on it. The mean of each view's landmarks is moved to the origin, in training
    and in test. By the released protocol they stay where they are, since the authors' scripts
    normalise pixels as they come.
    """
    if run.protocol == "released":
        return dataset
    return replace(
        dataset,
        views=np.float32(centre(dataset.views)),
        description=dataset.description | {"views": _CENTRED},
    )


def load_faces(run: Run, part: str) -> Faces:
    """Read `"train"` or `"test"` faces of a run.

    Raises:
        InputError: The file is missing or damaged, or of an earlier version of the FLAME track.
    """
    path = run.work / f"{part}.npz"
    dataset = load_dataset(path)
    centred = run.track == "flame" and run.protocol != "released"
    if centred and dataset.description.get("views") != _CENTRED:
        raise InputError(
            f"{path} must hold centred views. Received one made by an earlier version; delete "
            f"{run.work} and run again."
        )
    return as_seen(dataset)


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


def image_files(run: Run, part: str) -> ImageFiles:
    """Where the images of `"train"` or `"test"` faces are, or will be."""
    n = {"train": run.preset.train_images, "test": run.preset.test_faces}[part]
    return ImageFiles(run.work / "images" / part, n, IMAGE_SIZE)


def crop_files(run: Run, n: int) -> ImageFiles:
    """Where the squares cut out of the photos of n test faces are, or will be.

    Those of the CelebA experiment are what MobileFace sees; those of the FLAME track, RingNet.
    """
    size = IMAGE_SIZE if run.track == "celeba" else CROP_SIZE
    return ImageFiles(run.work / "images" / "test", n, size)


def ring_files(run: Run) -> ImageFiles:
    """Where the images that RingNet is trained on are, or will be."""
    n = run.preset.ring_subjects * run.preset.ring_images
    return ImageFiles(run.work / "images" / "rings", n, IMAGE_SIZE)


def load_rings(run: Run) -> tuple[ImageFiles, np.ndarray, np.ndarray]:
    """Images that RingNet is trained on, landmarks `(n, L, 2)` in them, and who each is, `(n,)`.

    Raises:
        InputError: A file is missing or was changed.
    """
    files = ring_files(run)
    files.check(load_record(run, "rings")["checksums"]["rings"])
    subjects = np.arange(len(files)) // run.preset.ring_images
    return files, files.landmarks(range(len(files))), subjects


def of_used(table: Mapping[str, np.ndarray], key: str) -> np.ndarray:
    """An array of the scans, or photos, that gave a test face."""
    return table[key][table["status"] == USED]


def load_crops(run: Run) -> ImageFiles:
    """Photos of the test faces of the FLAME track, or of the CelebA experiment.

    Raises:
        InputError: A file is missing or was changed.
    """
    files = crop_files(run, len(load_dataset(run.work / "test.npz")))
    name = "photos" if run.track == "celeba" else "scans"
    files.check(load_record(run, name)["checksums"]["test"])
    return files


def load_images(run: Run, part: str) -> ImageFiles:
    """Images as their stage left them.

    Raises:
        InputError: A file is missing or was changed.
    """
    files = image_files(run, part)
    files.check(load_record(run, "images")["checksums"][part])
    return files


def load_landmark_model(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Mean `(L, 3)` and identity basis times s.d. `(K, L, 3)` of the landmarks, millimetres."""
    arrays, _ = read_arrays(run.work / "landmark_model.npz")
    return arrays["mean"], arrays["identity_basis_times_sd"]


def load_shape_gram(run: Run) -> np.ndarray:
    """`(K, K)` mean product of two components' offsets over all coordinates of the mesh, mm²."""
    arrays, _ = read_arrays(run.work / "landmark_model.npz")
    return arrays["shape_gram"]
