"""The paper's figure of CelebA faces with FLAME's landmarks, or of rendered ones in their place.

The folder is `data` of the public repository TF_FLAME: photos, and 51 landmarks of each.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from data_gen.rendering.crops import crop
from deepmds_keras.alignment import align
from deepmds_keras.detection.mediapipe_landmarks import detect, landmarks51
from deepmds_keras.detection.mediapipe_models import has_face_mesh
from deepmds_keras.io.errors import InputError
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.normalisation import centre, normalise
from deepmds_keras.photos import IMAGE_SIZE, open_photo
from experiments.arguments import parse_run
from experiments.figures.gallery import gallery
from experiments.figures.style import save
from experiments.inputs import CROP_MARGIN, CROP_SIZE, load_faces
from experiments.manifest import clear_results, records_of, write_manifest
from experiments.methods import load
from experiments.records import load_record
from experiments.run import Run
from experiments.running import stage
from experiments.tracks.celeba.stand_in_photos import stand_in_photos

_METHODS = ("zhao", "ours", "ours_stable", "lifting")  # beside those that see the photo
_PHOTO = 224  # pixels of a side of a photo in the picture
_MOST = 12  # faces in the picture


def read_folder(folder: Path) -> tuple[list[Path], np.ndarray]:
    """Photos and their landmarks.

    Args:
        folder: With `NAME.jpeg` (or jpg, png) and `NAME_lmks.npy` of each face, `(51, 2)` pixels,
            x right and y down, in the order of iBUG's landmarks 18 to 68.

    Returns:
        Paths in order of name, at most 12, and `(n, 51, 2)`.

    Raises:
        InputError: No such folder or none of these files in it, or landmarks of another shape.
    """
    found = sorted(folder.glob("*_lmks.npy"))[:_MOST]
    if not found:
        raise InputError(
            f"TF_FLAME={folder} must be a folder with photos NAME.jpeg and landmarks "
            "NAME_lmks.npy, such as data/ of https://github.com/TimoBolkart/TF_FLAME. "
            "Received none of these."
        )
    photos, landmarks = [], []
    for path in found:
        stem = path.name.removesuffix("_lmks.npy")
        images = [folder / f"{stem}{suffix}" for suffix in (".jpeg", ".jpg", ".png")]
        photo = next((image for image in images if image.is_file()), None)
        if photo is None:
            raise InputError(f"{path} must have its photo beside it, {images[0].name}. None found.")
        try:
            points = np.load(path, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise InputError(f"{path} must be an array (51, 2). Received {error}.") from None
        if points.shape != (51, 2) or not np.isfinite(points).all():
            raise InputError(f"{path} must be finite (51, 2). Received shape {points.shape}.")
        photos.append(photo)
        landmarks.append(points.astype(float))
    return photos, np.array(landmarks)


def shapes_of(flame: Run, images: list[np.ndarray], landmarks: np.ndarray) -> dict[str, np.ndarray]:
    """Shapes by every method that can be run: `(n, 51, 3)`, NaN where it found no face."""
    views = normalise(centre(landmarks * (1, -1)))
    shapes = {name: load(flame, name).predict(views) for name in _METHODS}
    if (flame.work / f"{flame.ringnet_stage}.json").exists():
        size = IMAGE_SIZE if flame.ringnet is None else CROP_SIZE
        squares = [crop(*pair, size, CROP_MARGIN)[0]
                   for pair in zip(images, landmarks, strict=True)]  # fmt: skip
        shapes["ringnet"] = load(flame, "ringnet").predict(np.stack(squares))
    if has_face_mesh():
        shapes["mediapipe_corrected"] = landmarks51(detect(images))
    mean = load_faces(flame, "train").shapes.mean(0).astype(float)
    return {name: upright(own, mean) for name, own in shapes.items()}


def upright(shapes: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Shapes turned, scaled and moved, but not mirrored, onto the mean: to be seen from in front.

    NaN stays NaN.
    """
    turned = np.full(shapes.shape, np.nan)
    found = np.isfinite(shapes).all((1, 2))
    targets = np.broadcast_to(mean, shapes[found].shape)
    turned[found] = align(shapes[found].astype(float), targets, reflection=False)
    return turned


def main(arguments: list[str] | None = None) -> None:
    flame = parse_run(__doc__, arguments).on("flame")
    name = "celeba-flame" + "-stand-in" * (flame.tf_flame is None)
    folder = flame.experiment_results(name)
    with stage(flame, name) as record:
        if flame.tf_flame is None:
            images, landmarks = stand_in_photos(flame)
        else:
            photos, landmarks = read_folder(Path(flame.tf_flame))
            images = [open_photo(path) for path in photos]
            record["faces"] = [path.name for path in photos]
        shapes = shapes_of(flame, images, landmarks)
        squares = [crop(*pair, _PHOTO, CROP_MARGIN)
                   for pair in zip(images, landmarks, strict=True)]  # fmt: skip
        order = ("ringnet", "mediapipe_corrected", *_METHODS)
        shapes = {name: shapes[name] for name in order if name in shapes}
        figure = gallery(
            *map(np.stack, zip(*squares, strict=True)), shapes, load_scheme(flame.scheme)
        )
        clear_results(folder)
        save(figure, folder / "figures", "celeba_flame")
        record["methods"] = [*shapes]
        record["model_sha256"] = load_record(flame, "frames")["model_sha256"]
    target = "reproduce-flame" if flame.tf_flame is None else "reproduce-celeba"
    write_manifest(flame, target, records_of(flame, name), folder)
