"""Basel Face Model 2009: the MATLAB file `01_MorphableModel.mat`.

Paysan et al. 2009, doi:10.1109/AVSS.2009.58; licensed by the University of Basel.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from data_gen.formats.mat5 import read_mat
from data_gen.models.mesh import orient_outwards
from data_gen.models.model_files import (
    as_basis,
    expect_format,
    find_path,
    known_landmarks,
    model_of,
)
from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.errors import InputError
from deepmds_keras.files import sha256_of

FILENAME = "01_MorphableModel.mat"
CANDIDATES = (
    FILENAME,
    f"PublicMM1/{FILENAME}",
    f"BaselFaceModel/PublicMM1/{FILENAME}",
    f"BaselFaceModel/{FILENAME}",
)
N_VERTICES = 53490
_MM = 1e-3  # the file is in micrometres
_KEYS = ("shapeMU", "shapePC", "shapeEV", "texMU", "texPC", "texEV", "tl")


@np.errstate(over="ignore", invalid="ignore")  # what is too large is refused in the end
def load_bfm2009(path: str | Path) -> MorphableModel:
    """Reads the Basel Face Model 2009.

    `shapeEV` holds standard deviations, whatever its name says; `tl` counts vertices from 1 and
    winds triangles clockwise.

    Args:
        path: `01_MorphableModel.mat`, or a folder that holds it or `PublicMM1/`.

    Returns:
        The model; landmarks `"bfm72"` where it has all 53,490 vertices (subsets number anew).

    Raises:
        InputError: The file is missing, damaged, of another format, or its sizes disagree.
    """
    file = find_path(path, CANDIDATES, what="the Basel Face Model 2009")
    arrays = _read(file)
    mean, basis = _statistics(file, arrays, "shape", _MM)
    colour_mean, colour_basis = _statistics(file, arrays, "tex", 1 / 255)
    if colour_mean.shape != mean.shape:
        raise InputError(
            f"{file}: texMU must have as many numbers as shapeMU, {mean.size}. "
            f"Received {colour_mean.size}."
        )
    n_vertices = len(mean)
    return model_of(
        file,
        name="bfm2009",
        mean=mean,
        identity_basis_times_sd=basis,
        triangles=orient_outwards(mean, _triangles(file, arrays["tl"], n_vertices)),
        landmarks=(
            known_landmarks("bfm2009", np.arange(n_vertices)) if n_vertices == N_VERTICES else {}
        ),
        colour_mean=colour_mean.clip(0, 1),
        colour_basis_times_sd=colour_basis,
        sha256=sha256_of([file]),
    )


def _read(file: Path) -> dict[str, np.ndarray]:
    expect_format(file, b"MATLAB", "a MATLAB file")
    with file.open("rb") as stream:
        if stream.read(10).startswith(b"MATLAB 7"):
            raise InputError(
                f"{file}: must be a MATLAB v5 to v7 file, as the model is distributed. "
                "Received v7.3 (HDF5)."
            )
    arrays = read_mat(file, _KEYS)
    for key in _KEYS:
        if key not in arrays:
            raise InputError(
                f"{file}: must hold {', '.join(_KEYS)}. Received a file without {key}."
            )
        if arrays[key] is None:
            raise InputError(f"{file}: {key} must be an array of numbers. Received another kind.")
    return arrays


def _statistics(
    file: Path, arrays: dict[str, np.ndarray], prefix: str, unit: float
) -> tuple[np.ndarray, np.ndarray]:
    mean = arrays[f"{prefix}MU"].ravel().astype(np.float64)
    columns = arrays[f"{prefix}PC"]
    sd = arrays[f"{prefix}EV"].ravel().astype(np.float64)
    if mean.size % 3 or columns.shape != (mean.size, sd.size) or not sd.size:
        raise InputError(
            f"{file}: {prefix}MU, {prefix}PC, {prefix}EV must have shapes (3n, 1), (3n, k), (k, 1)."
            f" Received {arrays[f'{prefix}MU'].shape}, {columns.shape}, "
            f"{arrays[f'{prefix}EV'].shape}."
        )
    return mean.reshape(-1, 3) * unit, as_basis(columns, sd * unit)


def _triangles(file: Path, tl: np.ndarray, n_vertices: int) -> np.ndarray:
    if tl.ndim != 2 or tl.shape[1] != 3 or not tl.size or tl.min() != 1 or tl.max() != n_vertices:
        raise InputError(
            f"{file}: tl must be (T, 3) and count the {n_vertices} vertices from 1. "
            f"Received shape {tl.shape}{f', from {tl.min()} to {tl.max()}' if tl.size else ''}."
        )
    return tl.astype(int) - 1
