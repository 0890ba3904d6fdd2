"""Every face model by its name on the command line, and where its files are."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from data_gen.models.basel import load_bfm2009, load_bfm2017
from data_gen.models.bfm68 import MEAN, bfm68_files, load_bfm68
from data_gen.models.flame import find_embedding, load_flame
from data_gen.models.ict import NEUTRAL, load_ict
from data_gen.models.morphable_model import MorphableModel
from data_gen.models.openhead import OPENHEAD, load_openhead
from deepmds_keras.errors import InputError, check_choice


@dataclass(frozen=True)
class FaceModel:
    """One value of `MODEL=`.

    Attributes:
        files: Names of its file, in order of preference; none if it comes with this package.
        place: Function of that file that returns what `load` takes, such as the folder above.
        parts: Function of this place that returns all files that `load` reads.
        scheme: Its landmarks, if it has no others and is for the BFM track alone.
    """

    title: str
    load: Callable[..., MorphableModel]
    files: tuple[str, ...] = ()
    source: str = ""
    place: Callable[[Path], Path] = lambda file: file
    parts: Callable[[Path], list[Path]] = lambda file: [file]
    scheme: str | None = None


_ICT = "https://github.com/ICT-VGL/ICT-FaceKit (MIT licence)"
_BASEL = "https://faces.dmi.unibas.ch/bfm/ (free for research, by web form)"
_FLAME = "https://flame.is.tue.mpg.de/ (free for research, after registration)"
MODELS = {
    "openhead": FaceModel("the open head", load_openhead),
    "ict": FaceModel(
        "ICT faces",
        load_ict,
        (NEUTRAL, "ict_light.npz"),
        _ICT,
        place=lambda file: file.parent if file.name == NEUTRAL else file,  # one mesh of many
        parts=lambda place: sorted(place.glob("*.obj")) if place.is_dir() else [place],
    ),
    "bfm2009": FaceModel("Basel Face Model 2009", load_bfm2009, ("01_MorphableModel.mat",), _BASEL),
    "bfm68": FaceModel(
        "Basel Face Model 2009 at 68 landmarks",
        load_bfm68,
        (MEAN,),
        "https://github.com/cleardusk/3DDFA (for research only)",
        place=lambda file: file.parent.parent,
        parts=bfm68_files,
        scheme="ibug68",
    ),
    "bfm2017": FaceModel(
        "Basel Face Model 2017",
        load_bfm2017,
        ("model2017-1_bfm_nomouth.h5", "model2017-1_face12_nomouth.h5"),
        _BASEL,
    ),
    "bfm2019": FaceModel(
        "Basel Face Model 2019",
        partial(load_bfm2017, name="bfm2019"),
        ("model2019_bfm.h5", "model2019_face12.h5", "model2019_fullHead.h5"),
        _BASEL,
    ),
    "flame": FaceModel(
        "FLAME",
        load_flame,
        (
            "generic_model.pkl",
            "flame2023.pkl",
            "flame2023_no_jaw.pkl",
            "generic_model.npz",
            "flame.npz",
        ),
        _FLAME,
        parts=lambda file: [file, find_embedding(file)],
    ),
}
OPEN = ("openhead", "ict")
TITLES = {name: model.title for name, model in MODELS.items()}
_DEPTHS = ("", "*/", "*/*/")  # of the subfolders in which files are searched for
# The tip of the nose on FLAME's template, measured by the public landmark embedding.
_FLAME_NOSE_TIP_MM = np.array([0.3, -9.4, 75.8])
_NOSE_TIP = 13  # of the landmarks ibug51


def load_model(name: str, path: str | Path | None = None, scheme: str = "bfm72") -> MorphableModel:
    """Loads a face model on which the landmarks of a scheme are known.

    With the landmarks `"ibug51"`, which are FLAME's, the model is shifted so that the tip of its
    nose is where FLAME has it: the paper's unit of length depends on the origin.

    Args:
        path: File or folder of the model (`DATA=` on the command line). `"openhead"` comes with
            this package and needs none.

    Raises:
        InputError: Unknown name; the model's files are missing (the message says which, and where
            to get them) or unusable; or it lacks the landmarks or, for `"ibug51"`, expressions.
    """
    file = find_model(name, path)
    model = MODELS[name].load(file)
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


def find_model(name: str, path: str | Path | None) -> Path:
    """File of a model, or its folder where it has several: the path itself, or within it.

    The open head's is in this package, whatever the path.

    Raises:
        InputError: Unknown name; or there is no file with one of the model's names, or several with
            the most preferred one. The message says where to get it.
    """
    if name == "openhead":
        return OPENHEAD
    check_choice(name, "MODEL", MODELS)
    model, received = MODELS[name], "nothing"
    if path:
        path = Path(path)
        places = [path] if path.is_file() else []
        for pattern in (depth + file for file in model.files for depth in _DEPTHS):
            places = places or sorted(path.glob(pattern))
        if len(places) == 1:
            return model.place(places[0])
        received = ", ".join(map(str, places)) or f"{path}, which holds none of them"
    raise InputError(
        f"DATA= must be the file of {name}, or a folder that holds one: {', '.join(model.files)}, "
        f"from {model.source}. Received {received}."
    )


def model_files(name: str, path: str | Path | None = None) -> list[Path]:
    """Files that `load_model` reads of a face model.

    Raises:
        InputError: As `load_model`, of files that are missing.
    """
    files = MODELS[name].parts(find_model(name, path))
    if missing := [str(file) for file in files if not file.is_file()]:
        raise InputError(
            f"DATA= must hold all files of {name}, from {MODELS[name].source}. "
            f"Received none at {', '.join(missing)}."
        )
    return files


def open_models(path: str | Path | None) -> tuple[list[str], list[str]]:
    """Of `OPEN`, the models that anybody may use, those with files here, and the others."""
    present, given = [], Path(path or "")
    for name in OPEN:
        if MODELS[name].files and given.is_file() and given.name not in MODELS[name].files:
            continue  # a file of another model
        with suppress(InputError):
            model_files(name, path)
            present.append(name)
    return present, [name for name in OPEN if name not in present]
