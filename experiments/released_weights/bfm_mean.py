"""The mean of the Basel Face Model at the paper's 72 landmarks, from the authors' weights.

The last layer of their autoencoder is a batch normalisation, whose offset is the mean of its
training targets: x and y of normalised shapes. Their depth net (Zhao et al.) gives the depth of
that frontal view. `bfm72_mean.csv` is the result of `extract_mean` for the released weights.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.geometry.alignment import procrustes

SCHEME = "bfm72"
MEAN = Path(__file__).with_name("bfm72_mean.csv")
_LAST_BIAS = "batch_normalization_6/batch_normalization_6/beta:0"
_EYE_CORNERS, _BETWEEN_MM = [0, 56], 86.7  # outer ones, on the model itself


def read_mean() -> np.ndarray:
    """`(72, 3)` millimetres, in the frame and about the origin of the Basel Face Model."""
    return np.loadtxt(MEAN, delimiter=",", skiprows=1)


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


def about_mean(model: MorphableModel, scale: float) -> MorphableModel:
    """Landmarks of faces around the Basel mean, with another model's variation times a scale.

    The offsets of the other model are rotated and scaled by the similarity that aligns its mean to
    the Basel one.
    """
    part, mean = model.restrict(model.landmarks[SCHEME]), read_mean()
    turn = procrustes(part.mean, mean, reflection=False)
    basis = scale * turn.scale * part.identity_basis_times_sd @ turn.rotation
    landmarks = {SCHEME: np.arange(len(mean))}
    return replace(part, mean=mean, identity_basis_times_sd=basis, landmarks=landmarks)
