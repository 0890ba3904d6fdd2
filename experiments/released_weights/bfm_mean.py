"""Step: the mean of the Basel Face Model at the paper's 72 landmarks, from the authors' weights.

The last layer of their autoencoder is a batch normalisation, whose offset is the mean of its
training targets: x and y of normalised shapes. Their depth net (Zhao et al.) gives the depth of
that frontal view. The model's licence does not let us hand the mean on.
"""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np

from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.errors import InputError
from deepmds_keras.files import write_bytes
from deepmds_keras.geometry.alignment import procrustes
from experiments.recipes import ZHAO_FILES
from experiments.run import AUTHORS_FILES, Run

SCHEME = "bfm72"
FILES = AUTHORS_FILES["bfm"][0], *ZHAO_FILES["bfm"]  # autoencoder, depth net
_LAST_BIAS = "batch_normalization_6/batch_normalization_6/beta:0"
_EYE_CORNERS, _BETWEEN_MM = [0, 56], 86.7  # outer ones, on the model itself


def main(run: Run) -> None:
    mean, text = extract_mean(*(authors_file(run, name) for name in FILES)), io.StringIO()
    np.savetxt(text, mean, "%.3f", delimiter=",", header="x_mm,y_mm,z_mm", comments="")
    write_bytes(mean_file(run), text.getvalue().encode())


def authors_file(run: Run, name: str) -> Path:
    """Path of a file of the authors' weights.

    Raises:
        InputError: No folder of them was given.
    """
    if not run.authors:
        raise InputError("AUTHORS must be the folder of the authors' weights. Received none.")
    return Path(run.authors, name)


def mean_file(run: Run) -> Path:
    return run.work / "released-weights" / "bfm72_mean.csv"


def read_mean(run: Run) -> np.ndarray:
    """`(72, 3)` millimetres, in the frame and about the origin of the Basel Face Model."""
    return np.loadtxt(mean_file(run), delimiter=",", skiprows=1)


def extract_mean(autoencoder: Path, depth_net: Path) -> np.ndarray:
    """The same from the authors' files.

    Normalised shapes span [0, 1] over all three axes, so the foremost landmark has a depth of 1.
    The origin of the model lies in its plane of symmetry, which gives the shift of `normalise`.
    """
    import h5py  # here, since the Snakefile imports this module too

    from deepmds_keras.baselines.zhao import Zhao, normalise_view

    with h5py.File(autoencoder) as file:
        frontal = file[_LAST_BIAS][()].reshape(1, -1, 2).astype(float)
    shape = Zhao(frontal.shape[1]).load_released(depth_net).predict(frontal)[0]
    depth = shape[:, 2] * normalise_view(frontal)[1].item()
    mean = np.column_stack([frontal[0], depth + 1 - depth.max()])
    corners = mean[_EYE_CORNERS]
    shift = corners[:, 0].mean()
    return (mean - shift) * _BETWEEN_MM / np.linalg.norm(corners[0] - corners[1])


def about_mean(model: MorphableModel, scale: float, mean: np.ndarray) -> MorphableModel:
    """Landmarks of faces around a mean `(72, 3)`, with a model's variation times a scale.

    The offsets of the model are rotated and scaled by the similarity that aligns its mean to the
    given one.
    """
    part = model.at_landmarks(SCHEME)
    turn = procrustes(part.mean, mean, reflection=False)
    basis = scale * turn.scale * part.identity_basis_times_sd @ turn.rotation
    landmarks = {SCHEME: np.arange(len(mean))}
    return replace(part, mean=mean, identity_basis_times_sd=basis, landmarks=landmarks)
