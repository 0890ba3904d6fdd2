"""Data sets: landmarks of faces and one view of each, sampled from a model, and their file.

The faces are neutral, or rings of several images of each subject, or frames of performances: the
open substitute for CoMA (Ranjan et al. 2018, doi:10.1007/978-3-030-01219-9_43), which has 12
subjects, 12 sequences and 20,466 frames and is available on request only.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_gen.models.expressions import SEQUENCES, sample_expressions, sequence_weights
from data_gen.models.morphable_model import MorphableModel
from data_gen.views import sample_cameras
from deepmds_keras.errors import InputError
from deepmds_keras.files import read_arrays, write_arrays
from deepmds_keras.geometry.views import PROJECTIONS, Cameras, project

_FACES_PER_CHUNK = 4096  # bounds the memory to some ten megabytes whatever the number of faces
_ARRAYS = ("identity", "expression", "landmarks", "views")


@dataclass(frozen=True, eq=False)
class Dataset:
    """Faces and one view of each.

    Attributes:
        identity: `(n, K)` float32, coefficients of the morphable model; K is 0 for faces from
            elsewhere.
        expression: `(n, E)` float32, its expression weights; E is 0 for neutral faces, or those
            from elsewhere.
        landmarks: `(n, L, 3)` float32, millimetres, frame of the morphable model.
        views: `(n, L, 2)` float32, millimetres in the plane of the face, y up.
        description: Its origin: model, hash of that, scheme, protocol, seed.
    """

    identity: np.ndarray
    expression: np.ndarray
    landmarks: np.ndarray
    views: np.ndarray
    cameras: Cameras
    description: dict

    def __len__(self) -> int:
        return len(self.landmarks)


def make_dataset(
    model: MorphableModel,
    n: int,
    rng: np.random.Generator,
    *,
    scheme: str = "bfm72",
    protocol: str = "paper",
    progress: Callable[[int], object] | None = None,
) -> Dataset:
    """Sample faces of standard-normal identity and neutral expression, and project each once.

    Only the landmarks of each face are computed, in chunks.

    Args:
        protocol: As for `sample_cameras`.
        progress: Called with the number of faces just sampled.

    Raises:
        InputError: The model has no landmarks of that scheme, or the protocol is unknown.
    """
    part, cameras = model.at_landmarks(scheme), sample_cameras(n, rng, protocol)
    identity = np.empty((n, model.n_identity), np.float32)
    landmarks = np.empty((n, part.n_vertices, 3), np.float32)
    views = np.empty((n, part.n_vertices, 2), np.float32)
    for start in range(0, n, _FACES_PER_CHUNK):
        faces = slice(start, min(start + _FACES_PER_CHUNK, n))
        identity[faces], points = part.sample(faces.stop - start, rng)
        landmarks[faces], views[faces] = points, project(points, cameras[faces])
        if progress is not None:
            progress(faces.stop - start)
    neutral, description = np.empty((n, 0), np.float32), _description(model, scheme, protocol)
    return Dataset(identity, neutral, landmarks, views, cameras, description)


def dataset_of(
    landmarks: np.ndarray,
    cameras: Cameras,
    description: dict,
    *,
    identity: np.ndarray | None = None,
    expression: np.ndarray | None = None,
) -> Dataset:
    """Project given landmarks.

    Args:
        landmarks: `(n, L, 3)` millimetres.
        identity, expression: Coefficients `(n, K)` and `(n, E)` of the faces, if they have any.
    """
    views = np.float32(project(landmarks.astype(float), cameras))
    none = np.empty((len(landmarks), 0), np.float32)
    identity = none if identity is None else np.float32(identity)
    expression = none if expression is None else np.float32(expression)
    return Dataset(identity, expression, np.float32(landmarks), views, cameras, description)


def make_rings(
    model: MorphableModel,
    n_subjects: int,
    images_per_subject: int,
    rng: np.random.Generator,
    *,
    scheme: str = "ibug51",
    protocol: str = "paper",
) -> Dataset:
    """Sample subjects of standard-normal identity, each in several expressions and views.

    Sanyal et al. 2019 (RingNet, arXiv:1905.06817) learn from rings of photos, all but one of which
    show the same person: they share the identity, but neither expression nor pose.

    Returns:
        Faces; face i shows subject i // images_per_subject.

    Raises:
        InputError: A model whose expressions have other names or that has no landmarks of that
            scheme, or an unknown protocol.
    """
    n = n_subjects * images_per_subject
    part, expression = model.at_landmarks(scheme), np.float32(sample_expressions(model, n, rng))
    cameras = sample_cameras(n, rng, protocol)
    of_subjects = rng.standard_normal((n_subjects, model.n_identity)).astype(np.float32)
    identity = np.repeat(of_subjects, images_per_subject, axis=0)
    description = _description(model, scheme, protocol) | {"images_per_subject": images_per_subject}
    landmarks = part.shape(identity, expression)
    return dataset_of(landmarks, cameras, description, identity=identity, expression=expression)


def make_performances(
    model: MorphableModel, n_subjects: int, n_frames: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Frames of performances: every subject performs every sequence once.

    Args:
        n_subjects: Number of subjects, each of standard-normal identity coefficients.
        n_frames: Total number of frames, distributed evenly over the performances, each of which
            needs three: neutral, something, neutral.

    Returns:
        `(n, K)` identity coefficients and `(n, E)` expression weights, both float32, of the frames
        by subject, then sequence, then time.

    Raises:
        InputError: The names of the model's expressions are not known.
    """
    n_performances = n_subjects * len(SEQUENCES)
    identity = np.float32(rng.standard_normal((n_subjects, model.n_identity)))
    lengths = np.diff(np.arange(n_performances + 1) * n_frames // n_performances)
    performed = zip(SEQUENCES * n_subjects, lengths, strict=True)
    expression = [sequence_weights(model, name, length, rng) for name, length in performed]
    subject = np.repeat(np.arange(n_performances), lengths) // len(SEQUENCES)
    return identity[subject], np.float32(np.concatenate(expression))


def _description(model: MorphableModel, scheme: str, protocol: str) -> dict:
    names = {"model": model.name, "model_sha256": model.sha256}
    return names | {"scheme": scheme, "protocol": protocol}


def save_dataset(path: str | Path, dataset: Dataset) -> None:
    """Write an npz, under a temporary name until it is complete."""
    arrays = {key: getattr(dataset, key) for key in _ARRAYS}
    arrays |= {key: np.float32(value) for key, value in vars(dataset.cameras).items()}
    write_arrays(path, arrays, dataset.description, compressed=False)


def load_dataset(path: str | Path) -> Dataset:
    """Read what `save_dataset` wrote; nothing in the file is executed.

    Raises:
        InputError: Missing or truncated file, a missing or misshapen array, NaN or infinity.
    """
    arrays, description = read_arrays(path, "a data set (npz)")
    n, n_landmarks = (*np.shape(arrays.get("landmarks")), 0, 0)[:2]
    needed = {"landmarks": (n, n_landmarks, 3), "views": (n, n_landmarks, 2)}
    needed |= {key: (n,) for key in Cameras.__dataclass_fields__}
    needed |= {key: (n, *np.shape(arrays.get(key))[1:2]) for key in ("identity", "expression")}
    for key, shape in needed.items():
        array = arrays.get(key, np.empty(0, str))
        if array.shape != shape or array.dtype.kind not in "fiu" or not np.isfinite(array).all():
            raise InputError(
                f"{path}: {key} must be finite numbers of shape {shape}. "
                f"Received {f'{array.dtype} {array.shape}' if key in arrays else 'nothing'}."
            )
    cameras = {key: arrays[key].astype(float) for key in Cameras.__dataclass_fields__}
    if not np.isin(cameras["projection"], range(len(PROJECTIONS))).all():
        raise InputError(f"{path}: projection must be a number below {len(PROJECTIONS)}.")
    cameras["projection"] = cameras["projection"].astype(int)
    return Dataset(*(arrays[key] for key in _ARRAYS), Cameras(**cameras), description)
