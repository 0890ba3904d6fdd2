"""Every face model by its name on the command line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from data_gen import bfm2009, bfm2017, ict
from data_gen.errors import DataError
from data_gen.model_files import find_path
from data_gen.morphable_model import MorphableModel
from data_gen.openhead import load_openhead

MODELS = ("openhead", "ict", "bfm2009", "bfm2017", "bfm2019")

_BASEL = "https://faces.dmi.unibas.ch/bfm/ (free for research, by web form)"
_SOURCES = {
    "ict": (ict.CANDIDATES, "https://github.com/ICT-VGL/ICT-FaceKit (MIT licence)"),
    "bfm2009": (bfm2009.CANDIDATES, _BASEL),
    "bfm2017": (bfm2017.CANDIDATES["bfm2017"], _BASEL),
    "bfm2019": (bfm2017.CANDIDATES["bfm2019"], _BASEL),
}
_LOADERS: dict[str, Callable[[Path], MorphableModel]] = {
    "ict": ict.load_ict,
    "bfm2009": bfm2009.load_bfm2009,
    "bfm2017": lambda path: bfm2017.load_bfm2017(path, "bfm2017"),
    "bfm2019": lambda path: bfm2017.load_bfm2017(path, "bfm2019"),
}


def load_model(name: str, path: str | Path | None = None) -> MorphableModel:
    """Loads a face model together with its 72 landmarks.

    Args:
        name: One of `MODELS`.
        path: File or folder of the model (`DATA=` on the command line). `"openhead"` comes with
            this package and needs none.

    Raises:
        DataError: Another name; the model's files are not there (the message says which and where
            to get them) or unusable; or its 72 landmarks are not known.
    """
    if name == "openhead":
        return load_openhead()
    if name not in _LOADERS:
        raise DataError(f"MODEL must be one of {', '.join(MODELS)}. Received {name!r}.")
    filenames, source = _SOURCES[name]
    if not path:
        raise DataError(
            f"DATA= must be the file or folder of {name}: {', '.join(filenames)}, from {source}. "
            "Received none."
        )
    try:
        path = find_path(path, filenames, what=name)
    except DataError as error:
        raise DataError(f"DATA={error} Get it from {source}.") from None
    model = _LOADERS[name](path)
    if "bfm72" not in model.landmarks:
        raise DataError(
            f"{path}: must be a {name} mesh on which the 72 landmarks are known. "
            f"Received one of {model.n_vertices} vertices without landmarks."
        )
    return model
