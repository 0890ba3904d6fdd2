"""Stage 1: faces and their views. Also what the later stages read of them, in the paper's unit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tqdm import tqdm

from data_gen.dataset import load_dataset, make_dataset, save_dataset
from data_gen.image_files import ImageFiles
from data_gen.models import load_model
from data_gen.projections import Cameras, in_camera_frame
from deepmds_keras.normalisation import normalise, unit
from deepmds_keras.photos import IMAGE_SIZE
from deepmds_keras.weights import read_arrays, write_arrays
from experiments.run import Run, load_record, parse_run, stage

SCHEME = "bfm72"


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


def load_faces(run: Run, part: str) -> Faces:
    """Read `"train"` or `"test"` faces of a run."""
    dataset = load_dataset(run.work / f"{part}.npz")
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


def load_images(run: Run, part: str) -> ImageFiles:
    """Images as their stage left them.

    Raises:
        DataError: A file is missing or was changed.
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


def make_faces(run: Run) -> dict:
    """Write the training faces, the test faces and the landmark model of a run.

    Returns:
        Name and hash of the morphable model, for the record.
    """
    model = load_model(run.model, run.data)
    landmarks = model.restrict(model.landmarks[SCHEME])
    components = model.identity_basis_times_sd.reshape(model.n_identity, -1)
    arrays = {
        "mean": landmarks.mean,
        "identity_basis_times_sd": landmarks.identity_basis_times_sd,
        "shape_gram": components @ components.T / components.shape[1],
    }
    write_arrays(run.work / "landmark_model.npz", arrays, {"model": model.name})
    sizes = {"train": run.preset.train_faces, "test": run.preset.test_faces}
    for number, (part, n) in enumerate(sizes.items()):
        rng = np.random.default_rng([run.seed, number])
        with tqdm(total=n, desc=f"{part} faces", unit="face") as bar:
            dataset = make_dataset(
                model, n, rng, scheme=SCHEME, protocol=run.protocol, progress=bar.update
            )
        save_dataset(run.work / f"{part}.npz", dataset)
    return {"model": model.name, "model_sha256": model.sha256}


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    with stage(run, "faces") as record:
        record |= make_faces(run)


if __name__ == "__main__":
    main()
