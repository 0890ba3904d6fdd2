"""Step: the paper's figure of CelebA faces with FLAME's landmarks, or of rendered substitutes.

`TF_FLAME=` is the folder `data` of the public repository TF_FLAME: photos with 51 landmarks each.
"""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.files import map_npy
from deepmds_keras.geometry.alignment import align
from deepmds_keras.geometry.units import centre, normalise
from deepmds_keras.landmarks import convert, load_scheme
from deepmds_keras.tool.detection.dlib_landmarks import shared_detector
from deepmds_keras.tool.detection.photos import open_photo
from experiments.figures.qualitative import gallery
from experiments.figures.style import save
from experiments.inputs import CROP_MARGIN, load_faces
from experiments.methods import METHODS, load, predict
from experiments.records import new_results
from experiments.run import Run
from experiments.streams import Stream
from experiments.tracks.results import face_squares

_PHOTO = 224  # side of a photo in the picture, pixels
_YAWS = (0, 15, 30, 45)  # degrees; the rendered photos nearest to these are shown
_DRAWN = 60


def read_folder(folder: Path) -> tuple[list[Path], np.ndarray]:
    """Photos and their landmarks.

    Args:
        folder: With `NAME.jpeg` and `NAME_lmks.npy` of each face, `(51, 2)` pixels, x right and y
            down, in the order of iBUG's landmarks 18 to 68.

    Returns:
        Paths in order of name, and `(n, 51, 2)`.

    Raises:
        InputError: No such folder or none of these files in it, or landmarks of another shape.
    """
    # macOS leaves ._NAME next to NAME.
    files = sorted(p for p in folder.glob("*_lmks.npy") if not p.name.startswith("."))
    if not files:
        raise InputError(
            f"TF_FLAME={folder} must be a folder with photos NAME.jpeg and landmarks "
            "NAME_lmks.npy, such as data/ of https://github.com/TimoBolkart/TF_FLAME. "
            "Received none of these."
        )
    landmarks = [map_npy(path) for path in files]
    for path, points in zip(files, landmarks, strict=True):
        if points.shape != (51, 2) or not np.isfinite(points).all():
            raise InputError(f"{path} must be finite (51, 2). Received shape {points.shape}.")
        if not (photo := _photo(path)).is_file():
            raise InputError(f"{path} must have its photo beside it. Received no {photo.name}.")
    return [*map(_photo, files)], np.array(landmarks, float)


def _photo(landmarks: Path) -> Path:
    return landmarks.with_name(f"{landmarks.name.removesuffix('_lmks.npy')}.jpeg")


def draw_photos(run: Run) -> tuple[list[np.ndarray], np.ndarray, list[str]]:
    """Photos rendered in place of CelebA's, and the 51 landmarks that dlib finds in them.

    Returns:
        `(H, W, 3)` uint8 each, of heads turned by up to 45 degrees, `(n, 51, 2)` pixels, and what
        the heads are turned by.

    Raises:
        InputError: The face model cannot be drawn, or dlib finds no face.
    """
    from data_gen.datasets.photos_substitute import Portraits
    from data_gen.models.registry import load_model

    model = load_model(run.model, run.data)
    detections = []
    for photo in Portraits(model, (run.seed, Stream.SUBSTITUTE_PHOTOS)).photos(range(_DRAWN)):
        landmarks = next(iter(shared_detector().detect_all(photo.image)), None)
        if landmarks is not None:
            detections.append((abs(photo.yaw), photo.image, convert(landmarks, "ibug68", "ibug51")))
    if not detections:
        raise InputError(f"dlib must find a face in {_DRAWN} photos of {run.model}. None found.")
    yaws, images, landmarks = zip(*detections, strict=True)
    nearest = dict.fromkeys(np.abs(np.array(yaws) - yaw).argmin() for yaw in _YAWS)
    titles = [f"turned by {yaws[k]:.0f}°" for k in nearest]
    return [images[k] for k in nearest], np.stack([landmarks[k] for k in nearest]), titles


def inputs_for(method: str, images: list[np.ndarray], landmarks: np.ndarray):
    """Input of a method for the photos."""
    if not METHODS[method].sees_images:
        return normalise(centre(landmarks * (1, -1)))
    size = METHODS[method].image_size
    return images if size is None else face_squares(images, landmarks, size, CROP_MARGIN)[0]


def upright(shapes: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Shapes aligned to the mean by a similarity without reflection. NaN stays NaN."""
    turned = np.full(shapes.shape, np.nan)
    finite = np.isfinite(shapes).all((1, 2))
    targets = np.broadcast_to(mean, shapes[finite].shape)
    turned[finite] = align(shapes[finite].astype(float), targets, reflection=False)
    return turned


def main(run: Run, *methods: str) -> dict:
    folder = run.experiment_results("celeba-flame" + "-substitute" * (run.tf_flame is None))
    record = {}
    if run.tf_flame is None:
        # VTK and TensorFlow do not get on in one process.
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
            images, landmarks, titles = process.submit(draw_photos, run).result()
    else:
        photos, landmarks = read_folder(Path(run.tf_flame))
        images = [open_photo(path) for path in photos]
        record["faces"] = titles = [path.name for path in photos]
    mean = load_faces(run, "train").shapes.mean(0).astype(float)
    # Methods that see the photo are drawn next to it.
    order = sorted(methods, key=lambda method: METHODS[method].inputs)
    shapes = {}
    for method in order:
        predicted = predict(load(run, method), inputs_for(method, images, landmarks))
        shapes[method] = upright(predicted, mean)
    squares = face_squares(images, landmarks, _PHOTO, CROP_MARGIN)
    figure = gallery(*squares, shapes, titles, load_scheme(run.scheme))
    save(figure, new_results(folder) / "figures", "celeba_flame", run.preset.caution)
    return record | {"methods": order, "results": [str(folder)]}
