"""Models by name: the lifters, the paper's networks, or a user's saved model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from threading import Lock
from typing import ClassVar

import numpy as np

from deepmds_keras.errors import InputError, needs
from deepmds_keras.files import instead_of_file, read_arrays
from deepmds_keras.geometry.camera import HeadPose, head_poses, refit
from deepmds_keras.landmarks import convert, face_sizes, load_scheme, scheme_of, unnamed
from deepmds_keras.lifting.lifter import LandmarkLifter
from deepmds_keras.weights import PRETRAINED, pretrained_path

_MIT = "MIT licence"


class LifterModel:
    """A lifter: facts about the shipped weights, by landmark scheme, and how it predicts."""

    family = "lifting"
    shipped: ClassVar = {s: f"lifting-{s}" for s in ("ibug51", "ibug68", "bfm72")}
    trained_on = (
        "landmarks of the open head (CC0 assets) and of ICT-FaceKit (MIT), no photo of a person"
    )
    turns: Mapping = {"yaw": 90, "pitch": 40}  # degrees to either side, in training
    # Residual of a pose above which landmarks hardly belong to the shape: with errors of 2 mm it is
    # 0.01 to 0.03 for correct landmarks, 0.09 (median) with swapped brows.
    max_residual = 0.045
    centred = True  # accepts faces anywhere in the image

    def __init__(self, path: Path):
        self._lifter = LandmarkLifter.load(path)
        self.n_landmarks = self._lifter.n_landmarks
        if path.parent != PRETRAINED:
            self.turns = {}  # nobody knows

    def predict(
        self,
        views: np.ndarray,
        landmark_sd: np.ndarray | None,
        jobs: int,
        progress: Callable[[int], object],
    ) -> tuple[np.ndarray, np.ndarray | None, HeadPose]:
        """Faces in views `(n, L, 2)`, y up, NaN where a landmark is missing.

        Returns:
            Shapes `(n, L, 3)`, their s.d. if the model estimates it, and their cameras.
        """
        shapes, std, pose = self._lifter.estimate(views, landmark_sd=landmark_sd)
        progress(len(views))
        return shapes, std, refit(pose, views, shapes)


class PaperNetworks:
    """The networks of the paper, Deep-MDS; attributes and `predict` are those of `LifterModel`."""

    family = "deepmds"
    shipped: ClassVar = {s: f"deepmds-{s}" for s in ("ibug51", "bfm72")}
    trained_on = (
        "landmarks of the open head (CC0 assets), centred, at a learning rate that decays along a "
        "cosine, no photo of a person"
    )
    turns: Mapping = {"yaw": 50, "pitch": 25, "roll": 30}
    max_residual = 0.12

    def __init__(self, path: Path):
        with needs("TensorFlow with Keras, which run the paper's networks,", "keras"):
            from deepmds_keras.deep_mds import DeepMDS

        self._networks, self._turn = DeepMDS.load(path), Lock()
        self._networks.set_params(solver="numba" if find_spec("numba") else "sklearn")
        self.n_landmarks = self._networks.n_landmarks
        self.centred = self._networks.centre_views

    def predict(
        self,
        views: np.ndarray,
        landmark_sd: np.ndarray | None,
        jobs: int,
        progress: Callable[[int], object],
    ) -> tuple[np.ndarray, None, HeadPose]:
        """As for `LifterModel`; no landmark may be missing, and s.d. are neither used nor given."""
        if np.isnan(views).any():
            raise InputError(
                "the model deepmds needs all landmarks; the model lifting takes faces with some "
                f"missing. Received {np.isnan(views).any(2).sum()} missing landmarks."
            )
        with self._turn:  # threads share the networks, and their n_jobs
            self._networks.set_params(n_jobs=jobs)
            shapes = self._networks.predict(views, check_orientation=False, progress=progress)
        return shapes, None, head_poses(views, shapes)


Model = LifterModel | PaperNetworks
# The shipped ones.
FAMILIES: Mapping[str, type[Model]] = {row.family: row for row in (LifterModel, PaperNetworks)}
DEFAULT, FALLBACK = LifterModel.family, "ibug51"  # for landmarks that have no weights


def given_scheme(scheme: str | Path | None, model: str | None) -> str | None:
    """The scheme of landmarks that are given for a model.

    Returns:
        That which is named; without a name, that of a lifter of other objects; None for faces,
        whose scheme their number tells.

    Raises:
        InputError: There is no such model.
    """
    if scheme is not None:
        return str(scheme)
    if model is None or model in FAMILIES:
        return None
    n_landmarks = load_model(model).n_landmarks
    return None if _is_of_faces(n_landmarks) else unnamed(n_landmarks)


def target_scheme(scheme: str, model: str | None) -> str:
    """The scheme to which landmarks must be converted for a model.

    Returns:
        Its name; that of the landmarks if they lack some that the model needs.

    Raises:
        InputError: There is no such model, or it is of other objects than the landmarks.
    """
    name = model or DEFAULT
    if name in FAMILIES:
        if scheme in FAMILIES[name].shipped:
            return scheme
        if _lacks(scheme, FALLBACK):
            raise InputError(
                f"The landmarks of {scheme} need their own model (--model), unless they include "
                f"those of {FALLBACK}. Received the model {name}."
            )
        return FALLBACK
    for family in FAMILIES.values():
        for of, weights in family.shipped.items():
            if weights == name and not _lacks(scheme, of):
                return of  # even if one's own scheme has as many, in another order
    given, n_landmarks = load_scheme(scheme), load_model(name).n_landmarks
    if len(given) == n_landmarks:
        return scheme
    if not _is_of_faces(n_landmarks):
        raise InputError(
            f"The model {name} needs its {n_landmarks} landmarks. They are not a face's, so it "
            f"takes no photos or videos. Received {len(given)}."
        )
    target = scheme_of(n_landmarks)
    return scheme if _lacks(scheme, target) else target


def scheme_of_model(scheme: str | Path | None, model: str | None, n_landmarks: int) -> str:
    """The scheme of a model's landmarks: the given one, or that of a face of as many.

    Raises:
        InputError: There is no such model or scheme, or the scheme has another number.
    """
    name = given_scheme(scheme, model) or scheme_of(n_landmarks)
    received = len(load_scheme(name))
    if received != n_landmarks:
        raise InputError(
            f"{name} must have the {n_landmarks} landmarks of {model}. Received {received}."
        )
    return name


def _is_of_faces(n_landmarks: int) -> bool:
    """Whether a face's scheme has so many, and none that it leaves out, such as irises."""
    return n_landmarks in face_sizes() and len(load_scheme(scheme_of(n_landmarks))) == n_landmarks


def _lacks(scheme: str, other: str) -> bool:
    """Whether some landmarks of the other scheme are none of the first."""
    points = np.zeros((len(load_scheme(scheme)), 2))
    return bool(np.isnan(convert(points, scheme, other, missing="nan")).any())


def name_for(scheme: str, model: str | None) -> str:
    """Name of a model; for a family, that of its weights for a landmark scheme."""
    name = model or DEFAULT
    return FAMILIES[name].shipped[scheme] if name in FAMILIES else name


def describe_model(scheme: str, model: str | None) -> dict[str, str]:
    """Name, method, provenance and licence of a model, for the files that are written."""
    name = name_for(scheme, model)
    kind = family_of(model)
    described = {"name": name, "method": kind.family}
    if name not in kind.shipped.values():
        return described | {"weights": "given by the user"}
    source = f"shipped with deepmds-keras; trained on {kind.trained_on}"
    return described | {"weights": source, "licence": _MIT}


def family_of(model: str | None) -> type[Model]:
    """The row of `FAMILIES` of a model, which is loaded unless it is a family's name."""
    return FAMILIES.get(model or DEFAULT) or type(load_model(str(model)))


def load_model(name: str) -> Model:
    """Load shipped weights by name, or a file; the model is cached until the file changes.

    Raises:
        InputError: It is neither.
    """
    path = weights_path(name).absolute()
    status = path.stat()
    return _load(path, (status.st_mtime_ns, status.st_size))


def weights_path(name: str) -> Path:
    """File of weights: the path itself, or that of shipped weights by name.

    Raises:
        InputError: There is no such file, and no shipped weights of that name.
    """
    path = Path(name)
    if path.is_file():
        return path
    if path.suffix:
        raise InputError(
            f"{path} must be a file written by LandmarkLifter.save() or DeepMDS.save(). "
            f"Received {instead_of_file(path)}."
        )
    try:
        return pretrained_path(name)
    except InputError as error:
        raise InputError(
            f"model must be {' or '.join(FAMILIES)}, a file from LandmarkLifter.save() or "
            f"DeepMDS.save(), or its {error}"
        ) from None


@lru_cache(8)
def _load(path: Path, version: tuple[int, int]) -> Model:
    arrays, _ = read_arrays(path)
    return (LifterModel if "basis" in arrays else PaperNetworks)(path)
