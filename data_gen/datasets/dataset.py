"""A data set: landmarks of faces and one view of each, as a file."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_gen.models.morphable_model import MorphableModel
from data_gen.views.projections import PROJECTIONS, Cameras, project, sample_cameras
from deepmds_keras.errors import InputError, brief
from deepmds_keras.files import atomic_write, read_npz

_FACES_PER_CHUNK = 4096  # bounds the memory to some ten megabytes whatever the number of faces


@dataclass(frozen=True, eq=False)
class Dataset:
    """Faces and one view of each.

    Attributes:
        identity: `(n, K)` float32, coefficients of the morphable model; K is 0 where the faces are
            not of one.
        expression: `(n, E)` float32, its expression weights; E is 0 where the faces are neutral, or
            not of a model.
        landmarks: `(n, L, 3)` float32, millimetres, frame of the morphable model.
        views: `(n, L, 2)` float32, millimetres in the plane of the face, y up.
        cameras: Pose and projection of each face.
        description: What it was made of: model, its hash, scheme, protocol, seed.
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
        model: Morphable model with landmarks of the scheme.
        n: Number of faces.
        rng: Source of the random numbers.
        scheme: Landmark scheme.
        protocol: As for `sample_cameras`.
        progress: Called with the number of faces just made.

    Raises:
        InputError: The model has no landmarks of that scheme, or the protocol is unknown.
    """
    if scheme not in model.landmarks:
        raise InputError(
            f"scheme must be one of {', '.join(model.landmarks)} for {model.name}. "
            f"Received {scheme!r}."
        )
    cameras = sample_cameras(n, rng, protocol)
    model_of_landmarks = model.restrict(model.landmarks[scheme])
    identity = np.empty((n, model.n_identity), np.float32)
    landmarks = np.empty((n, model_of_landmarks.n_vertices, 3), np.float32)
    views = np.empty((n, model_of_landmarks.n_vertices, 2), np.float32)
    for start in range(0, n, _FACES_PER_CHUNK):
        faces = slice(start, min(start + _FACES_PER_CHUNK, n))
        identity[faces], points = model_of_landmarks.sample(faces.stop - start, rng)
        landmarks[faces] = points
        views[faces] = project(points, cameras[faces])
        if progress is not None:
            progress(faces.stop - start)
    description = {
        "model": model.name,
        "model_sha256": model.sha256,
        "scheme": scheme,
        "protocol": protocol,
    }
    neutral = np.empty((n, 0), np.float32)
    return Dataset(identity, neutral, landmarks, views, cameras, description)


def dataset_of(
    landmarks: np.ndarray,
    cameras: Cameras,
    description: dict,
    *,
    identity: np.ndarray | None = None,
    expression: np.ndarray | None = None,
) -> Dataset:
    """Project given landmarks, in chunks.

    Args:
        landmarks: `(n, L, 3)` millimetres.
        cameras: One for each face.
        description: What the landmarks were made of.
        identity, expression: Coefficients `(n, K)` and `(n, E)` of the faces, where they have some.
    """
    n = len(landmarks)
    views = np.empty((*landmarks.shape[:2], 2), np.float32)
    for start in range(0, n, _FACES_PER_CHUNK):
        faces = slice(start, start + _FACES_PER_CHUNK)
        views[faces] = project(landmarks[faces].astype(float), cameras[faces])
    identity, expression = (
        np.empty((n, 0), np.float32) if coefficients is None else np.float32(coefficients)
        for coefficients in (identity, expression)
    )
    return Dataset(identity, expression, np.float32(landmarks), views, cameras, description)


def save_dataset(path: str | Path, dataset: Dataset) -> None:
    """Write an npz, under a temporary name until it is complete."""
    cameras = {key: np.float32(value) for key, value in vars(dataset.cameras).items()}
    with atomic_write(Path(path)) as file:
        np.savez(
            file,
            identity=dataset.identity,
            expression=dataset.expression,
            landmarks=dataset.landmarks,
            views=dataset.views,
            description=np.array(json.dumps(dataset.description)),
            **cameras,
        )


def load_dataset(path: str | Path) -> Dataset:
    """Read what `save_dataset` wrote; nothing in the file is executed.

    Raises:
        InputError: Missing or truncated file, a missing or misshapen array, NaN or infinity.
    """
    arrays = read_npz(path, "a data set (npz)")
    n, n_landmarks = (*arrays.get("landmarks", np.empty(0)).shape, 0, 0)[:2]
    needed = {
        "identity": (n, *arrays.get("identity", np.empty(0)).shape[-1:]),
        "expression": (n, *arrays.get("expression", np.empty(0)).shape[-1:]),
        "landmarks": (n, n_landmarks, 3),
        "views": (n, n_landmarks, 2),
        "description": (),
    }
    needed |= {key: (n,) for key in Cameras.__dataclass_fields__}
    for key, shape in needed.items():
        if key not in arrays or arrays[key].shape != shape:
            found = f"shape {arrays[key].shape}" if key in arrays else "nothing"
            raise InputError(f"{path}: {key} must have shape {shape}. Received {found}.")
        what, kinds = ("text", "U") if key == "description" else ("numbers", "fiu")
        if arrays[key].dtype.kind not in kinds:
            raise InputError(f"{path}: {key} must be {what}. Received {arrays[key].dtype}.")
        if key != "description" and not np.isfinite(arrays[key]).all():
            raise InputError(f"{path}: {key} must be finite. Received NaN or infinity.")
    angles = {key: arrays[key].astype(float) for key in Cameras.__dataclass_fields__}
    if not np.isin(angles["projection"], range(len(PROJECTIONS))).all():
        raise InputError(f"{path}: projection must be a number below {len(PROJECTIONS)}.")
    angles["projection"] = angles["projection"].astype(int)
    try:
        description = json.loads(str(arrays["description"]))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: description must be JSON. Received {brief(error)}.") from None
    kept = (arrays[key] for key in ("identity", "expression", "landmarks", "views"))
    return Dataset(*kept, Cameras(**angles), description)
