"""Every face model by its name on the command line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from data_gen.models import bfm2009, bfm2017, flame, ict
from data_gen.models.flame_embedding import find_embedding
from data_gen.models.model_files import find_path
from data_gen.models.morphable_model import MorphableModel
from data_gen.models.openhead import OPENHEAD, load_openhead
from deepmds_keras.errors import InputError

MODELS = ("openhead", "ict", "bfm2009", "bfm2017", "bfm2019", "flame")

OPEN = ("openhead", "ict")
_BASEL = "https://faces.dmi.unibas.ch/bfm/ (free for research, by web form)"
_FLAME = "https://flame.is.tue.mpg.de/ (free for research, after registration)"
# The tip of the nose on FLAME's template, measured by the public landmark embedding.
_FLAME_NOSE_TIP_MM = np.array([0.3, -9.4, 75.8])
_NOSE_TIP = 13  # of the landmarks ibug51
_SOURCES = {
    "ict": (ict.CANDIDATES, "https://github.com/ICT-VGL/ICT-FaceKit (MIT licence)"),
    "bfm2009": (bfm2009.CANDIDATES, _BASEL),
    "bfm2017": (bfm2017.CANDIDATES["bfm2017"], _BASEL),
    "bfm2019": (bfm2017.CANDIDATES["bfm2019"], _BASEL),
    "flame": (flame.CANDIDATES, _FLAME),
}
_LOADERS: dict[str, Callable[[Path], MorphableModel]] = {
    "ict": ict.load_ict,
    "bfm2009": bfm2009.load_bfm2009,
    "bfm2017": lambda path: bfm2017.load_bfm2017(path, "bfm2017"),
    "bfm2019": lambda path: bfm2017.load_bfm2017(path, "bfm2019"),
    "flame": flame.load_flame,
}


def open_models(path: str | Path | None) -> tuple[list[str], list[str]]:
    """The models that anybody may use, `OPEN`.

    Args:
        path: As for `load_model`.

    Returns:
        Those whose files are there, and those whose are not.
    """
    found = []
    for name in OPEN:
        try:
            model_files(name, path)
        except InputError:
            continue
        found.append(name)
    return found, [name for name in OPEN if name not in found]


def load_model(name: str, path: str | Path | None = None, scheme: str = "bfm72") -> MorphableModel:
    """Loads a face model on which the landmarks of a scheme are known.

    With the landmarks `"ibug51"`, which are FLAME's, the model is shifted so that the tip of its
    nose is where FLAME has it: the paper's unit of length depends on the origin.

    Args:
        name: One of `MODELS`.
        path: File or folder of the model (`DATA=` on the command line). `"openhead"` comes with
            this package and needs none.
        scheme: Landmark scheme.

    Raises:
        InputError: Another name; the model's files are not there (the message says which and where
            to get them) or unusable; or the landmarks are not known on it, or, for `"ibug51"`, no
            expressions.
    """
    model = load_openhead() if name == "openhead" else _load_file(name, path)
    if scheme not in model.landmarks:
        raise InputError(
            f"{name} must be a mesh on which the landmarks {scheme} are known. "
            f"Received one of {model.n_vertices} vertices without them."
        )
    if scheme != "ibug51" or name == "flame":
        return model
    if model.expression_basis is None:
        raise InputError(f"{name} must have expressions. Received a model without.")
    shift = _FLAME_NOSE_TIP_MM - model.mean[model.landmarks[scheme][_NOSE_TIP]]
    return replace(model, mean=model.mean + shift)


def model_files(name: str, path: str | Path | None = None) -> list[Path]:
    """Files that `load_model` reads of a face model.

    Raises:
        InputError: As `load_model`, of files that are missing.
    """
    if name == "openhead":
        return [OPENHEAD]
    found = _find(name, path)
    if name == "flame":
        return [found, find_embedding(*found.absolute().parents[:3])]
    if found.is_dir() or found.suffix == ".obj":
        return sorted((found if found.is_dir() else found.parent).glob("*.obj"))
    return [found]


def _load_file(name: str, path: str | Path | None) -> MorphableModel:
    file = _find(name, path)
    return _LOADERS[name](file)


def _find(name: str, path: str | Path | None) -> Path:
    if name not in _LOADERS:
        raise InputError(f"MODEL must be one of {', '.join(MODELS)}. Received {name!r}.")
    filenames, source = _SOURCES[name]
    if not path:
        raise InputError(
            f"DATA= must be the file or folder of {name}: {', '.join(filenames)}, from {source}. "
            "Received none."
        )
    try:
        return find_path(path, filenames, what=name)
    except InputError as error:
        raise InputError(f"DATA={error} Get it from {source}.") from None
