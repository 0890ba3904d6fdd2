"""The authors' implementation: one face at a time, one pair at a time.

Their MATLAB generator computes all vertices of each face, picks the landmarks and views them
through `viewmtx`. Their Python scripts compute the features of a face in two nested loops over all
L² ordered pairs, and call Keras's `predict` for each face, in mini-batches of 32 pairs. Textures,
renders and files, which those scripts also write, are left out. scikit-learn's `MDS` replaces
MATLAB's `mdscale(K, 3)`, which starts once, from classical scaling.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from sklearn.manifold import MDS

from data_gen.datasets.dataset import Dataset
from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.embedding import check_dissimilarities
from deepmds_keras.geometry.orientation import resolve_orientation
from deepmds_keras.geometry.units import centre, normalise
from deepmds_keras.geometry.views import Cameras, project, rotations

if TYPE_CHECKING:
    from deepmds_keras.deep_mds import DeepMDS  # which loads TensorFlow


def make_faces(
    model: MorphableModel, faces: Dataset, n: int, scheme: str
) -> tuple[np.ndarray, np.ndarray]:
    """Landmarks `(n, L, 3)` and views `(n, L, 2)` of the first faces, via all vertices."""
    landmarks, views = [], []
    for k in range(n):
        landmarks.append(model.shape(faces.identity[k])[model.landmarks[scheme]])
        views.append(project(landmarks[-1][None], faces.cameras[k : k + 1])[0])
    return np.stack(landmarks), np.stack(views)


def viewmtx(azimuth: float, elevation: float, field_of_view: float = 0.0) -> np.ndarray:
    """The matrix of MATLAB's function of that name, `(4, 4)`, from its public documentation.

    The viewer is at an azimuth about z, counted from -y, and an elevation above the x-y plane. With
    a field of view the unit cube fills that angle. The target lies where the sphere around the cube
    is nearest to the viewer: so in the help's worked examples, not the origin that it names.
    https://www.mathworks.com/help/matlab/ref/viewmtx.html

    Angles are in degrees; a field of view of 0 is orthographic.

    Returns:
        Matrix to be multiplied from the left to `(x, y, z, 1)`. Its first two rows, divided by the
        fourth, are the view, x to the right and y up. The fourth holds 1 less the depth beyond the
        target, in units of the viewer's distance.
    """
    turn, rise = np.deg2rad([azimuth, elevation])
    towards = np.array([np.cos(rise) * np.sin(turn), -np.cos(rise) * np.cos(turn), np.sin(rise)])
    right = np.array([np.cos(turn), np.sin(turn), 0.0])
    matrix = np.eye(4)
    matrix[:3, :3] = right, np.cross(towards, right), towards
    if field_of_view == 0:
        return matrix
    target = np.full(3, 0.5) + np.sqrt(3) / 2 * towards
    matrix[:3, 3] = -matrix[:3, :3] @ target
    distance = np.sqrt(2) / 2 / np.tan(np.deg2rad(field_of_view) / 2)
    matrix[3] = np.array([0, 0, 0, 1]) - matrix[2] / distance
    return matrix


def released_views(shapes: np.ndarray, cameras: Cameras) -> np.ndarray:
    """Views of the released generator, `(n, L, 2)`, by where the viewer stands."""
    points = np.concatenate([shapes, np.ones((*shapes.shape[:2], 1))], axis=2)
    x, y, z = rotations(cameras)[:, 2].T
    azimuths, elevations = np.rad2deg([np.arctan2(x, -y), np.arcsin(z)])
    viewers = zip(azimuths, elevations, cameras.field_of_view, strict=True)
    return points @ np.stack([viewmtx(*viewer)[:2].T for viewer in viewers])


def pair_features(view: np.ndarray, pairs: Iterable[tuple[int, int]]) -> np.ndarray:
    """The paper's features `(P, 6)` of pairs of the landmarks of one view, pair by pair."""
    features = []
    for i, j in pairs:
        difference = np.abs(view[i] - view[j])
        features.append(np.concatenate([difference, view[i] * view[j], np.exp(-difference)]))
    return np.array(features, np.float32)


def training_batches(
    frontal: np.ndarray, shapes: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Features `(P, F)` and distances `(P, 1)` of the pairs of each face, pair by pair."""
    pairs = [*zip(*np.triu_indices(shapes.shape[1], 1), strict=True)]
    for view, shape in zip(frontal, shapes, strict=True):
        distances = [[np.linalg.norm(shape[i] - shape[j])] for i, j in pairs]
        yield pair_features(view, pairs), np.array(distances, np.float32)


def predict(model: DeepMDS, views: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frontal views `(n, L, 2)` and dissimilarities `(n, L, L)`, one `predict` a face and net."""
    frontal, matrices = [], []
    for view in views:
        view = normalise(centre(view) if model.centre_views else view)
        predicted = model.autoencoder_.predict(view.reshape(1, -1), verbose=0)
        frontal.append(predicted.reshape(view.shape))
        points = np.float32(normalise(frontal[-1]))
        features = pair_features(points, product(range(len(points)), repeat=2))
        distances = model.dissimilarity_net_.predict(features, verbose=0)
        matrices.append(distances.reshape(len(points), len(points)))
    return np.stack(frontal), np.stack(matrices)


def embed(dissimilarities: np.ndarray) -> np.ndarray:
    """Points `(n, L, 3)` of `(n, L, L)`, from one classical start, of each face in turn."""
    options = {"metric": "precomputed", "init": "classical_mds", "normalized_stress": True}
    scaling = MDS(3, metric_mds=False, n_init=1, **options)
    return np.stack([*map(scaling.fit_transform, check_dissimilarities(dissimilarities))])


def shapes(model: DeepMDS, views: np.ndarray) -> np.ndarray:
    """3D landmarks of views, `(n, L, 2)` → `(n, L, 3)`, by the authors' steps throughout."""
    frontal, matrices = predict(model, views)
    return resolve_orientation(embed(np.abs(matrices)), frontal, model.front_landmark_)
