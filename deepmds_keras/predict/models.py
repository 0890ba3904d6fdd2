"""Models of the command: the lifters, the paper's networks, or what a user has saved."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from deepmds_keras.errors import InputError, needs
from deepmds_keras.files import read_arrays
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.landmarks.conversion import convert, scheme_of
from deepmds_keras.lifting.trained import TrainedLifter
from deepmds_keras.weights import pretrained_path

_CHUNK = 1000  # faces between two reports of progress
_MIT = "MIT licence"


class Lifting:
    """A lifter.

    Attributes:
        family: As `--model` names it.
        shipped: Landmark scheme to the name of its weights.
        trained_on: What these were trained on.
        turns: How far the heads in their training are turned, degrees to either side.
        loose: Residual of a pose beyond which landmarks hardly are those of the shape: 0.01 to 0.06
            where they are, 0.09 (median) where brows are swapped, 0.07 and more in another order.
        centred: Whether it takes faces anywhere in the image.
    """

    family = "lifting"
    shipped: ClassVar = {s: f"lifting-{s}" for s in ("ibug51", "ibug68", "bfm72")}
    trained_on = (
        "landmarks of the open head (CC0 assets) and of ICT-FaceKit (MIT), no photo of a person"
    )
    turns: ClassVar = {"yaw": 90, "pitch": 40}
    loose = 0.07
    centred = True

    def __init__(self, path: Path):
        self._lifter = TrainedLifter.read(path)
        self.n_landmarks = self._lifter.n_landmarks

    def predict(
        self,
        views: np.ndarray,
        landmark_sd: np.ndarray | None,
        jobs: int,
        progress: Callable[[int], object] | None,
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Shapes `(n, L, 3)` of views `(n, L, 2)`, y up, and their s.d. if the model knows it."""
        parts = []
        for start in range(0, len(views), _CHUNK):
            faces = slice(start, start + _CHUNK)
            sd = None if landmark_sd is None else landmark_sd[faces]
            # The command has judged how the faces stand.
            options = {"landmark_sd": sd, "return_std": True, "check_orientation": False}
            parts.append(self._lifter.predict(views[faces], **options))
            if progress is not None:
                progress(len(parts[-1][0]))
        shapes, std = zip(*parts, strict=True)
        return np.concatenate(shapes), np.concatenate(std)


class PaperNetworks:
    """The networks of the paper, Deep-MDS; attributes and `predict` as of `Lifting`."""

    family = "deepmds"
    shipped: ClassVar = {s: f"deepmds-{s}" for s in ("ibug51", "bfm72")}
    trained_on = "landmarks of the open head (CC0 assets), no photo of a person"
    turns: ClassVar = {"yaw": 50, "pitch": 25, "roll": 30}
    loose = 0.12

    def __init__(self, path: Path):
        with needs("TensorFlow with Keras, which run the paper's networks,", "keras"):
            from deepmds_keras.pipeline import DeepMDS

        self._networks = DeepMDS.load(path)
        self.n_landmarks = self._networks.n_landmarks
        self.centred = self._networks.centre_views

    def predict(self, views, landmark_sd, jobs, progress):
        """As of `Lifting`; there is no s.d., and that of the landmarks is not looked at."""
        self._networks.set_params(n_jobs=jobs)
        shapes = self._networks.predict(views, check_orientation=False, progress=progress)
        return shapes, None


Model = Lifting | PaperNetworks
# Those that ship.
FAMILIES: Mapping[str, type[Model]] = {row.family: row for row in (Lifting, PaperNetworks)}
DEFAULT, FALLBACK = Lifting.family, "ibug51"  # of landmarks that there are no weights for


def taken(scheme: str, model: str | None) -> str:
    """The scheme in which a model takes landmarks that are in another.

    Returns:
        Its name; that of the landmarks' own if they lack some that the model takes.

    Raises:
        InputError: There is no such model, or it takes no known scheme.
    """
    family = FAMILIES.get(model or DEFAULT)
    if family is not None:
        return scheme if scheme in family.shipped else FALLBACK
    target = scheme_of(_parameters(model).get("n_landmarks", 0))
    points = np.zeros((len(load_scheme(scheme)), 2))
    lacking = np.isnan(convert(points, scheme, target, missing="nan")).any()
    return scheme if lacking else target


def model_for(scheme: str, model: str | None) -> Model:
    """The model by its name, and of a family the one for landmarks of a scheme.

    Raises:
        InputError: There is no such model.
    """
    family = FAMILIES.get(model or DEFAULT)
    return load_model(model if family is None else family.shipped[scheme])


def describe_model(scheme: str, model: str | None) -> dict[str, str]:
    """Name, method, provenance and licence of a model, which is not loaded, for the files."""
    family = FAMILIES.get(model or DEFAULT)
    name = model if family is None else family.shipped[scheme]
    kind = _kind(name)
    described = {"name": name, "method": kind.family}
    if name not in kind.shipped.values():
        return described | {"weights": "given by the user"}
    source = f"shipped with deepmds-keras; trained on {kind.trained_on}"
    return described | {"weights": source, "licence": _MIT}


def hash_weights(model: str | None) -> str:
    """SHA-256 of the weights that a run may use: of one model, or of a family.

    Raises:
        InputError: There is no such model.
    """
    family, digest = FAMILIES.get(model or DEFAULT), hashlib.sha256()
    for path in map(weights_path, (model,) if family is None else family.shipped.values()):
        try:
            digest.update(path.read_bytes())
        except OSError as error:
            raise InputError(
                f"{path} must be a file that LandmarkLifter.save() or DeepMDS.save() wrote. "
                f"Received: {error.strerror}."
            ) from None
    return digest.hexdigest()


@cache
def load_model(name: str) -> Model:
    """Shipped weights by name, or a file.

    Raises:
        InputError: Neither.
    """
    return _kind(name)(weights_path(name))


def _kind(name: str) -> type[Model]:
    return Lifting if "size" in _parameters(name) else PaperNetworks


@cache
def _parameters(name: str) -> dict[str, Any]:
    """What a file of weights says of its estimator; the networks are not built."""
    return read_arrays(weights_path(name))[1].get("parameters", {})


def weights_path(name: str) -> Path:
    """File of weights: itself, or that of shipped ones by their name.

    Raises:
        InputError: No file's name, and none of those that ship.
    """
    path = Path(name)
    if path.suffix or path.exists():
        return path
    try:
        return pretrained_path(name)
    except InputError as error:
        raise InputError(
            f"model must be {' or '.join(FAMILIES)}, a file of LandmarkLifter.save() or "
            f"DeepMDS.save(), or its {error}"
        ) from None
