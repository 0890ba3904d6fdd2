"""The way of the authors' released code: one face at a time, one pair at a time.

Their MATLAB generator makes all vertices of each face and picks the landmarks. Their Python scripts
join the features of a face in two nested loops over all L² ordered pairs. They call Keras'
`predict` for each face, whose mini-batches are of 32 pairs. Textures, renders and files, which
those scripts make too, are left out. For MATLAB's `mdscale` stands scikit-learn's `MDS` with four
random starts, which was its default up to version 1.8.
"""

from __future__ import annotations

from collections.abc import Iterable

import keras
import numpy as np

from data_gen.models.morphable_model import MorphableModel
from data_gen.views.projections import Cameras, project, sample_cameras
from deepmds_keras.embedding import check_dissimilarities, precomputed_mds
from deepmds_keras.normalisation import centre, normalise
from deepmds_keras.orientation import resolve_orientation
from deepmds_keras.pipeline import DeepMDS
from deepmds_keras.proximities import proximities

_STARTS = 4


def make_faces(
    model: MorphableModel, n: int, rng: np.random.Generator, scheme: str, protocol: str
) -> tuple[np.ndarray, np.ndarray]:
    """Random faces, made and projected one by one: `(n, L, 3)` landmarks and `(n, L, 2)` views."""
    faces = [
        face(model, rng.standard_normal(model.n_identity), sample_cameras(1, rng, protocol), scheme)
        for _ in range(n)
    ]
    landmarks, views = zip(*faces, strict=True)
    return np.stack(landmarks), np.stack(views)


def face(
    model: MorphableModel, identity: np.ndarray, camera: Cameras, scheme: str
) -> tuple[np.ndarray, np.ndarray]:
    """All vertices of a face of `(K,)` coefficients; its landmarks `(L, 3)` and view `(L, 2)`."""
    landmarks = model.shape(identity)[model.landmarks[scheme]]
    return landmarks, project(landmarks[None], camera)[0]


def all_pairs(n_landmarks: int) -> list[tuple[int, int]]:
    """Every ordered pair of landmarks, those of a landmark with itself included."""
    return [(i, j) for i in range(n_landmarks) for j in range(n_landmarks)]


def pair_features(view: np.ndarray, variant: str, pairs: Iterable[tuple[int, int]]) -> np.ndarray:
    """Features `(P, F)` of pairs of the landmarks of one view, pair by pair."""
    features = []
    for i, j in pairs:
        difference = np.abs(view[i] - view[j])
        product = view[i] * view[j]
        if variant == "paper":
            features.append(np.concatenate([difference, product, np.exp(-difference)]))
        else:
            distance = np.linalg.norm(view[i] - view[j])
            features.append(np.concatenate([product, np.exp(-difference), [distance]]))
    return np.array(features, np.float32)


def pair_distances(shape: np.ndarray, pairs: Iterable[tuple[int, int]]) -> np.ndarray:
    """Distances `(P, 1)` of pairs of the landmarks of one shape, pair by pair."""
    return np.array([[np.linalg.norm(shape[i] - shape[j])] for i, j in pairs], np.float32)


def predict(model: DeepMDS, views: np.ndarray, *, loops: bool) -> tuple[np.ndarray, np.ndarray]:
    """Frontal views `(n, L, 2)` and dissimilarities `(n, L, L)`, one `predict` a face and network.

    Args:
        model: Trained networks.
        views: `(n, L, 2)` views.
        loops: Whether the pair features are made pair by pair, or of all pairs at once.
    """
    frontal, matrices = [], []
    for view in views:
        view = normalise(centre(view) if model.centre_views else view)
        frontal.append(_predict(model.autoencoder_, view.reshape(1, -1)).reshape(view.shape))
        points = np.float32(normalise(frontal[-1]))
        if loops:
            features = pair_features(points, model.variant, all_pairs(len(points)))
        else:
            ends = np.repeat(points, len(points), axis=0), np.tile(points, (len(points), 1))
            features = proximities(*ends, model.variant)
        distances = _predict(model.dissimilarity_net_, features)
        matrices.append(distances.reshape(len(points), len(points)))
    return np.stack(frontal), np.stack(matrices)


def embed(dissimilarities: np.ndarray, seed: int = 0) -> np.ndarray:
    """Points `(n, L, 3)` of `(n, L, L)`: the best of four random starts, of each face in turn."""
    scaling = precomputed_mds(3, n_init=_STARTS, random_state=seed)
    return np.stack([scaling.fit_transform(own) for own in check_dissimilarities(dissimilarities)])


def shapes(model: DeepMDS, views: np.ndarray) -> np.ndarray:
    """3D landmarks of views, `(n, L, 2)` → `(n, L, 3)`, in all of this the released way."""
    frontal, matrices = predict(model, views, loops=True)
    return resolve_orientation(embed(np.abs(matrices)), frontal, model.front_landmark_)


def _predict(network: keras.Model, inputs: np.ndarray) -> np.ndarray:
    return network.predict(inputs, verbose=0)
